"""The findings of the collision report: sentences that are computed from its rows alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from spikingtac_paper.collision.methods import (
    PAPER_DELAY,
    PERFECT,
    PLUS_ONE,
    PUBLISHED,
    SAMPLED,
)
from spikingtac_paper.collision.plan import ALL, FASTEST, PRESETS, SLOW
from spikingtac_paper.harness.rows import Row

OURS = "default"
"""The method to which the aims apply."""

AIMS: tuple[tuple[str, str, float], ...] = (
    (f"{PRESETS[0]}/{ALL}", "deviation_mean_mm", 0.25),
    (f"{PRESETS[1]}/{ALL}", "deviation_mean_mm", 0.32),
    (f"{PRESETS[0]}/{FASTEST}", "deviation_max_mm", 0.45),
    (f"{PRESETS[0]}/{SLOW}", "deviation_mean_mm", 0.30),
    (f"{PRESETS[0]}/{SLOW}", "deviation_max_mm", 0.40),
    (f"{PRESETS[0]}/{SLOW}", "missed", 0.0),
    (f"{PRESETS[0]}/{ALL}", "false_stops_per_hour", 1.0),
    (f"{PRESETS[1]}/{ALL}", "false_stops_per_hour", 1.0),
    (f"{PRESETS[0]}/{ALL}", "decision_p99_us", 100.0),
)
"""(case, metric, largest value) at which the project aims."""
OVERSHOOT_AIM_MM = 0.45
"""Aim: largest excess of the overshoot at 0.18 m/s over that of a perfect sensor, mm."""

Rows = dict[tuple[str, str, str], Row]


def findings(rows: Sequence[Row]) -> list[str]:
    """Return the sentences of the first page of a report."""
    table = {(row.method, row.case, row.metric): row for row in rows}
    return [
        *_ratios(table),
        *_published(table),
        *_aims(table),
        *_overshoot(table),
        *_false_stops(table),
        *_errata(table),
        "Not a safety function: no performance level (ISO 13849), and no replacement for the "
        "robot's protective stop (ISO 10218).",
    ]


def _ratios(table: Rows) -> Iterator[str]:
    case = f"{PRESETS[0]}/{FASTEST}"

    def ratio(baseline: str, metric: str) -> float | None:
        above, below = _value(table, baseline, case, metric), _value(table, OURS, case, metric)
        return above / below if above is not None and below else None

    found = {
        name: (ratio(name, "overshoot_mean_mm"), ratio(name, "overshoot_max_mm"))
        for name in (SAMPLED, PLUS_ONE, PAPER_DELAY)
    }
    notes = {
        SAMPLED: "the sensor alone explains this ratio: 32 fps instead of 1 ms, nothing else",
        PLUS_ONE: "this one contains one more frame of latency",
        PAPER_DELAY: "this one contains the paper's 135 ms, of which some 100 ms are undocumented "
        "processing; the published five-fold improvement is of this kind",
    }
    for name, (mean, worst) in found.items():
        if mean is not None and worst is not None:
            yield (
                f"Overshoot at 0.18 m/s, {name} over {OURS}: {mean:.2f} (mean), {worst:.2f} "
                f"(worst); {notes[name]} (simulated, {case})."
            )


def _published(table: Rows) -> Iterator[str]:
    for preset in PRESETS:
        for speed in (SLOW, ALL):
            case = f"{preset}/{speed}"
            theirs = _value(table, PUBLISHED, case, "deviation_mean_mm")
            ours = _value(table, OURS, case, "deviation_mean_mm")
            missed = table.get((PUBLISHED, case, "missed"))
            if theirs is None or not ours or missed is None:
                continue
            printed = " (paper, its hardware: 0.53)" if case == f"{PRESETS[0]}/{ALL}" else ""
            yield (
                f"{case}: mean deviation of {PUBLISHED} {theirs:.3f} mm{printed}, of {OURS} "
                f"{ours:.3f} mm: {theirs / ours:.1f} times; {PUBLISHED} missed "
                f"{missed.value:.0f} of {missed.n} approaches (simulated)."
            )


def _aims(table: Rows) -> Iterator[str]:
    for case, metric, most in AIMS:
        row = table.get((OURS, case, metric))
        if row is not None and row.value is not None:
            verdict = "met" if row.value <= most else "missed"
            yield (
                f"{OURS}, {case}, {metric}: {row.value:.3g} {row.unit} (n = {row.n}), aim at most "
                f"{most:g}: {verdict} (simulated)."
            )


def _overshoot(table: Rows) -> Iterator[str]:
    for preset in PRESETS:
        case = f"{preset}/{FASTEST}"
        for metric, about in (("overshoot_mean_mm", "mean"), ("overshoot_max_mm", "worst")):
            ours, best = table.get((OURS, case, metric)), _value(table, PERFECT, case, metric)
            if ours is not None and ours.value is not None and best is not None:
                excess = ours.value - best
                verdict = "met" if excess <= OVERSHOOT_AIM_MM else "missed"
                yield (
                    f"{case}: {about} overshoot of {OURS} {ours.value:.2f} mm, of a perfect sensor "
                    f"on the same arm {best:.2f} mm: {excess:+.2f} mm over {ours.n} paired trials, "
                    f"aim at most {OVERSHOOT_AIM_MM}: {verdict} (simulated). The paper's 6.2 mm "
                    "belongs to its robot."
                )


def _false_stops(table: Rows) -> Iterator[str]:
    for preset in PRESETS:
        case = f"{preset}/{ALL}"
        for method in (OURS, PUBLISHED, SAMPLED):
            rate = _value(table, method, case, "false_stops_per_hour")
            low = _value(table, method, case, "false_stops_lower95_per_hour")
            high = _value(table, method, case, "false_stops_upper95_per_hour")
            hours = _value(table, method, case, "hours")
            if None not in (rate, low, high, hours):
                yield (
                    f"{case}: false stops of {method} {rate:.3g}/h in {hours:.1f} h of motion with "
                    f"vibration (exact 95 % interval {low:.2g} to {high:.2g}; budget 1/h; "
                    "simulated)."
                )


def _errata(table: Rows) -> Iterator[str]:
    case = f"{PRESETS[0]}/{FASTEST}"
    true, read = (
        _value(table, OURS, case, metric)
        for metric in ("deviation_mean_mm", "deviation_read_mean_mm")
    )
    if true is not None and read is not None:
        yield (
            f"A pose that is read at 125 Hz is stale: at 0.18 m/s the controller reports "
            f"{read - true:+.2f} mm against the truth on average. That alone can explain the "
            "paper's flat and negative deviations; the true and the reported one stand side by "
            "side here (simulated)."
        )
    yield (
        "The paper's baseline of 24.3 mm at 0.18 m/s is 135 ms, or 4.3 frames at 32 fps; a 32 fps "
        "camera without other latency gives the row frame_sampling (see the errata)."
    )


def _value(table: Rows, method: str, case: str, metric: str) -> float | None:
    row = table.get((method, case, metric))
    return row.value if row else None
