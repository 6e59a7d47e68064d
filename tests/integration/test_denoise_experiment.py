import pytest

from spikingtac_paper.denoise import (
    ACTIVITY,
    METHODS,
    METRICS,
    Plan,
    render,
    report_rows,
    score_all,
)

SEED, DURATION_S = 1001, 1.2


@pytest.fixture(scope="module")
def rows():
    plan = Plan(
        noise_hz=(1.0,), drop=(0.5,), duration_s=DURATION_S, every_us=100_000, first_us=600_000
    )
    return report_rows([score_all(render("finger-torsion", SEED, DURATION_S), plan, SEED)])


def test_every_method_case_and_metric_is_there(rows):
    methods = {prefix + name for prefix in ("", ACTIVITY) for name in METHODS}
    assert {row.method for row in rows} == methods
    cases = {row.case for row in rows}
    for kind in ("binary", "graded"):
        assert {f"{kind}@1.0-0.5", f"slow/{kind}@1.0-0.5", f"heldout/{kind}@1.0-0.5"} <= cases
    for row in rows:
        assert row.unit == METRICS[row.metric].unit
        assert row.source == "twin"
        assert row.n > 0 or row.value is None


def test_the_filter_and_the_network_find_every_marker(rows):
    table = {(row.method, row.case, row.metric): row.value for row in rows}
    assert table[f"{ACTIVITY}network-int8", "binary@1.0-0.5", "recall"] == 1.0
    noisy = table[f"{ACTIVITY}none", "binary@1.0-0.5", "excess_mean_px"]
    assert table[f"{ACTIVITY}network-int8", "binary@1.0-0.5", "excess_mean_px"] < noisy
