"""The experiment on what is felt: scores on made-up truths, drawn contacts, seeds."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.sim.timeline import Timeline
from spikingtac.touch import WrenchSeries
from spikingtac_paper.harness.report import lines_of, rows_of
from spikingtac_paper.harness.run import RunOptions
from spikingtac_paper.touch import experiment
from spikingtac_paper.touch.contacts import HOLD, KINDS, ROUND, TESTED, draw_contact
from spikingtac_paper.touch.forces import force_records, mean_displacement
from spikingtac_paper.touch.patches import WatchedPress, draw_press, patch_scores, watch_press
from spikingtac_paper.touch.slip import (
    CONTACTS,
    HELD_CONTACTS,
    HELD_SEED,
    SEED_STRIDE,
    SEEDS,
    TAUGHT_SEED,
    Truth,
    WatchedContact,
    alarms_of,
    slip_scores,
    truth_of,
    watch_contact,
)
from spikingtac_paper.touch.touches import touch_scores

TOUCHES = [(1_000_000, 2_000_000), (3_000_000, 4_000_000)]
T_US = np.arange(0, 1_000_000, 1_000)
ON = np.ones(len(T_US), np.bool_)


@pytest.mark.parametrize(
    ("found", "missed", "extra"),
    [
        ([(1_005_000, 2_050_000), (2_991_000, 3_950_000)], 0, 0),
        ([(1_020_000, 1_400_000), (1_500_000, 2_200_000), (5_000_000, 6_000_000)], 1, 2),
        ([(1_000_000, 4_100_000)], 1, 0),  # spans two, is one of them
        ([(1_900_000, 4_000_000), (3_200_000, 3_300_000)], 0, 0),  # as many as can be
        ([], 2, 0),
    ],
)
def test_each_touch_is_found_once(found: list[tuple[int, int]], missed: int, extra: int) -> None:
    scores = touch_scores(TOUCHES, found)
    assert (scores["missed"], scores["extra"]) == (missed, extra)
    if not missed + extra:
        in_time = float(found[0][0] < 1_100_000)
        assert (scores["begin_in_time"], scores["end_in_time"]) == (in_time, in_time)


def series(seed: int) -> WrenchSeries:
    rng = np.random.default_rng(seed)
    moved = rng.normal(0.0, 1.0, (400, 5, 2)) + rng.normal(0.0, 1.0, (400, 1, 2))
    length = np.sqrt((moved**2).sum(axis=2)).mean(axis=1)
    wrench = np.column_stack([2.0 * moved.mean(axis=1), -length])
    return WrenchSeries(np.arange(400), np.zeros((5, 2)), moved, wrench, "mm", f"s{seed}")


def test_each_recorded_series_is_predicted_from_the_others(tmp_path: Path) -> None:
    np.testing.assert_allclose(
        mean_displacement([series(1), series(2)])(series(3)), series(3).wrench, atol=1e-9
    )
    (tmp_path / "force").mkdir()
    for one in (series(1), series(2)):
        moved, wrench = one.displacement, np.pad(one.wrench, ((0, 0), (0, 3)))
        np.savez(tmp_path / "force" / f"{one.name}.npz", t_us=one.t_us, displacement_mm=moved,
                 reference_mm=np.zeros((5, 2)), wrench=wrench)  # fmt: skip
    records = force_records(tmp_path, ["mean-displacement"])
    cases = [record["trial"]["case"] for record in records]
    assert cases == ["force/s1", "force/s2", "force/pooled", "force/mean"]
    rows = rows_of(records, experiment.METRICS)
    assert "r2_fx 1" in lines_of(rows, ["force/pooled"], ["mean-displacement"])[0]


CELLS = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), axis=-1).reshape(-1, 2)


@pytest.fixture(scope="module")
def felt() -> WatchedPress:
    """A press on the twin, as camera and tracker see it."""
    return watch_press(draw_press(np.random.default_rng(3))[1], "typical", 3)


@pytest.fixture(scope="module")
def square(felt: WatchedPress) -> WatchedPress:
    """A press with a true patch of eight by eight cells of a pixel each."""
    touched = (np.abs(CELLS - 9.5) < 4.0).all(axis=1)
    return replace(
        felt, cells_px=CELLS, touched=touched, cell_px2=np.ones(len(CELLS)), px_per_mm=2.0
    )


def told(press: WatchedPress, side: float, shift: float = 0.0) -> dict[str, float]:
    """Scores where a square of some side is told, px."""
    place, corners = np.full(2, 9.5 + shift), np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    outline = place + 0.5 * side * corners
    touch = replace(press.touch, place_px=place, area_px2=side**2, outline_px=outline)
    return patch_scores(replace(press, touch=touch))


def test_patches_are_scored_by_overlap_area_and_place(square: WatchedPress) -> None:
    scores = told(square, 8.0)
    assert scores["overlap"] == scores["overlap_asked"] == scores["area_ratio"] == 1.0
    assert scores["place_mm"] == scores["missed_presses"] == 0.0
    shifted = told(square, 8.0, shift=2.0)
    assert shifted["overlap"] == pytest.approx(36 / (64 + 64 - 36))
    assert shifted["place_mm"] == pytest.approx(np.sqrt(2.0))
    assert told(square, 10.0)["area_ratio"] == pytest.approx(100 / 64)
    assert patch_scores(replace(square, touch=None)) == {"missed_presses": 1.0}
    assert square.width_mm == pytest.approx(8.0 / 2.0 * 2.0 / np.sqrt(3.0), rel=0.02)


def test_a_press_is_told_from_events_about_where_it_is(felt: WatchedPress) -> None:
    scores = patch_scores(felt)
    assert scores["overlap"] > 0.7
    assert scores["place_mm"] < 1.5


def slips(slow: bool = True) -> Truth:
    """A contact of 1 s that holds until 400 ms and has slipped at 600 ms."""
    share = np.interp(T_US, [0, 400_000, 600_000, 1_000_000], [1.0, 1.0, 0.0, 0.0])
    return Truth(T_US, share, ON, slow)


def test_alarms_in_time_are_right_and_late_ones_late() -> None:
    scores = slip_scores(slips(), [450_000], [598_000])
    assert scores["gross_in_time"] == scores["lead_20ms"] == 1.0
    assert scores["gross_delay_ms"] == pytest.approx(7.0, abs=2.0)
    assert scores["false_incipient"] == scores["false_gross"] == 0.0
    assert scores["sticking_s"] == pytest.approx(0.42, abs=0.01)
    late = slip_scores(slips(), [585_000], [620_000])
    assert late["gross_in_time"] == late["lead_20ms"] == 0.0
    assert "lead_20ms" not in slip_scores(slips(slow=False), [450_000], [598_000])


def test_alarms_of_a_contact_that_sticks_are_false() -> None:
    scores = slip_scores(slips(), [50_000], [200_000])
    assert scores["false_incipient"] == scores["false_gross"] == 1.0
    assert scores["false_gross_sticking"] == 1.0
    assert scores["gross_in_time"] == scores["lead_20ms"] == 0.0
    assert "gross_delay_ms" not in scores
    assert slip_scores(slips(), [380_000], [])["false_incipient"] == 0.0, "an early warning"
    partly = Truth(T_US, np.where(np.arange(1_000) < 400, 1.0, 0.5), ON, slow=True)
    scores = slip_scores(partly, [], [600_000])
    assert (scores["false_gross"], scores["false_gross_sticking"]) == (1.0, 0.0)


@pytest.mark.parametrize("kind", sorted(set(KINDS)))
def test_every_kind_of_contact_can_be_drawn_again(kind: str) -> None:
    drawn = [draw_contact(np.random.default_rng(3), TESTED, (0.3, 0.9), (kind,)) for _ in range(2)]
    assert drawn[0] == drawn[1]
    assert drawn[0].friction in (0.3, 0.9)
    assert drawn[0].kind == kind
    assert 0.5 < Timeline(drawn[0].scene, 0).duration_s < 12.0


@pytest.fixture(scope="module")
def slid() -> WatchedContact:
    """A finger that is dragged until it slips, as camera and tracker see it."""
    draws = (draw_contact(np.random.default_rng(seed), ROUND[2:], (0.5,), ("slide",))
             for seed in range(100))  # fmt: skip
    return watch_contact(next(one for one in draws if 8.0 < one.speed_mm_s < 20.0), 0)


def test_a_slide_on_the_twin_is_told(slid: WatchedContact) -> None:
    known = truth_of(slid)
    assert known.slow
    assert known.judged.sum() > 200
    incipient, gross = alarms_of("slip", slid)
    assert incipient[0] < gross[0]
    scores = slip_scores(known, incipient, gross)
    assert scores["false_incipient"] == scores["false_gross"] == 0.0
    assert abs(scores["gross_delay_ms"]) < 60.0


def test_a_body_that_stands_after_a_slip_is_judged_where_it_is_held_only(
    slid: WatchedContact,
) -> None:
    standing = (slid.t_us > slid.t_us[-1] - 380_000) & (slid.t_us < slid.t_us[-1] - 320_000)
    assert not slid.judged[standing].any()
    held = truth_of(replace(slid, contact=replace(slid.contact, kind=HOLD)))
    assert held.judged[standing].all()
    assert not held.judged[slid.t_us > slid.t_us[-1] - 280_000].any(), "released"
    assert not held.slow


METHODS = ("touches", "patch-model", "slip")


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """First methods and seeds of the parts that were run, of which none does anything."""
    ran: list[tuple[str, int]] = []

    def records(methods: list[str], seed: int, quick: bool) -> list[dict[str, Any]]:
        ran.append((methods[0], seed))
        trial = {"case": "slip/all", "groups": [], "seed": seed, "source": "twin"}
        return [{"method": methods[0], "trial": trial, "scores": {"sticking_s": 1.0}}]

    for name, part in experiment.PARTS.items():
        monkeypatch.setitem(experiment.PARTS, name, replace(part, records=records))
    return ran


def test_touches_have_three_seeds_unless_a_number_is_given(
    tmp_path: Path, ran: list[tuple[str, int]]
) -> None:
    options = RunOptions(output=tmp_path / "run", methods=METHODS)
    experiment.run(options)
    assert ran == [("touches", 0), ("touches", 1), ("touches", 2), ("patch-model", 0), ("slip", 0)]
    with pytest.raises(ConfigError, match="never mixed"):
        experiment.run(replace(options, resume=True, seed=7))
    ran.clear()
    experiment.run(replace(options, output=tmp_path / "other", seed=4, seeds=2, quick=True))
    assert ran == [(method, seed) for method in METHODS for seed in (4, 5)]


@pytest.mark.parametrize(("first", "count"), [(15, 1), (13, 3), (-1, 1)])
def test_seeds_of_contacts_that_slip_was_learned_from_are_refused(
    tmp_path: Path, ran: list[tuple[str, int]], first: int, count: int
) -> None:
    options = RunOptions(output=tmp_path / "run", methods=("slip",), seed=first, seeds=count)
    with pytest.raises(ConfigError, match=rf"seeds {first} to .* are given.*0 to 14"):
        experiment.run(options)
    assert not ran
    assert not (tmp_path / "run").exists()
    last = HELD_SEED + SEEDS[-1] * SEED_STRIDE + max(CONTACTS, HELD_CONTACTS)
    assert last <= TAUGHT_SEED, "no contact that is scored was learned from"
