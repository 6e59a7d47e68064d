"""The figures of the collision experiment, as SVG text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from spikingtac_paper.collision.methods import PAPER_DELAY, PUBLISHED, SAMPLED
from spikingtac_paper.collision.plan import (
    CURVE_SPEED,
    FASTEST,
    PRESETS,
    SENSITIVITY_SPEEDS,
    SPEEDS,
    VARIANTS,
)
from spikingtac_paper.harness.rows import Row
from spikingtac_paper.harness.svg import pyplot, svg_text

STYLES = {
    PUBLISHED: ("-", "#0969da"), "default": ("-", "#1a7f37"),
    SAMPLED: ("--", "#bc4c00"), PAPER_DELAY: ("--", "#cf222e"),
}  # fmt: skip
"""Method -> line (solid: events, dashed: frames) and colour."""
TRACE_US = (-30_000, 30_000)
"""Beginning and end of the trace, us from the touch."""


def speed_figure(rows: Sequence[Row]) -> str:
    """Draw the paper's figure: deviation (left) and overshoot (right) against speed."""
    figure, left = pyplot().subplots(figsize=(8, 4.2))
    right = left.twinx()
    speeds = [float(speed) for speed in SPEEDS]
    for method, (line, colour) in STYLES.items():
        for axis, metric, marker in (
            (left, "deviation_mean_mm", "o"),
            (right, "overshoot_mean_mm", "^"),
        ):
            found = {row.case: row.value for row in rows
                     if (row.method, row.metric) == (method, metric)}  # fmt: skip
            values = [found.get(f"{PRESETS[0]}/{speed}") for speed in SPEEDS]
            if any(value is not None for value in values):
                label = f"{method}, {'deviation' if axis is left else 'overshoot'}"
                numbers = np.array(values, float)
                axis.plot(speeds, numbers, line, marker=marker, ms=4, color=colour, label=label,
                          alpha=1.0 if axis is left else 0.45)  # fmt: skip
    left.set_xlabel("approach speed, m/s")
    left.set_ylabel("detection deviation, mm (simulated)")
    right.set_ylabel("overshoot, mm (simulated)")
    for axis in (left, right):
        axis.set_yscale("symlog", linthresh=1.0)
        axis.set_ylim(bottom=0.0)
    handles = [one for axis in (left, right) for one in axis.get_legend_handles_labels()[0]]
    left.legend(handles=handles, fontsize=7, ncols=2, loc="upper left")
    left.grid(alpha=0.3)
    return svg_text(figure)


def trace_figure(approaches: Sequence[Mapping[str, Any]]) -> str:
    """Draw the events per millisecond around a touch at several speeds."""
    cases = [f"{PRESETS[0]}/{speed}" for speed in ("0.01", "0.1", FASTEST)]
    shown = [
        next((r for r in approaches if r["case"] == case and r["counts"]), None) for case in cases
    ]
    traced = [record for record in shown if record is not None]
    if not traced:
        return ""
    figure, axes = pyplot().subplots(len(traced), 1, figsize=(8, 1.7 * len(traced)), squeeze=False)
    for axis, record in zip(axes[:, 0], traced, strict=True):
        ends_us = record["first_us"] + 1000.0 * np.arange(1, len(record["counts"]) + 1)
        after_us = ends_us - record["touch_us"]
        part = (after_us > TRACE_US[0]) & (after_us < TRACE_US[1])
        axis.step(after_us[part] * 1e-3, np.array(record["counts"])[part], color="#57606a", lw=1)
        axis.axvline(0.0, color="black", lw=1)
        for method in (PUBLISHED, "default"):
            outcome = record["methods"].get(method)
            if outcome is not None:
                colour = STYLES[method][1]
                axis.axvline(outcome["delay_us"] * 1e-3, color=colour, lw=1.5, label=method)
        axis.set_yscale("symlog", linthresh=100)
        axis.set_ylabel(f"events/ms\n{record['case'].split('/')[1]} m/s")
        axis.legend(fontsize=7, loc="upper left")
        axis.grid(alpha=0.3)
    axes[-1, 0].set_xlabel("time after the true first touch, ms (simulated)")
    return svg_text(figure)


def curve_figure(approaches: Iterable[Mapping[str, Any]], rows: Sequence[Row]) -> str:
    """Draw the mean delay against the measured false stops per hour, over several budgets."""
    delays: dict[str, list[float]] = {}
    for record in approaches:
        if record["group"] == "curve":
            for label, outcome in record["methods"].items():
                if outcome is not None and outcome["delay_us"] >= 0.0:
                    delays.setdefault(label, []).append(outcome["delay_us"] * 1e-3)
    rates = {row.method: row for row in rows
             if row.case == "budget" and row.metric == "false_stops_per_hour"}  # fmt: skip
    hours = next((row.value for row in rows if (row.case, row.metric) == ("budget", "hours")), None)
    if not delays or not rates or not hours:
        return ""
    figure, axis = pyplot().subplots(figsize=(7, 3.6))
    for method in dict.fromkeys(label.split("@")[0] for label in delays):
        labels = [label for label in delays if label.split("@")[0] == method and label in rates]
        # No false stop at all is drawn at half of one: the axis is logarithmic.
        x = [max(rates[label].value or 0.0, 0.5 / hours) for label in labels]
        axis.plot(x, [np.mean(delays[label]) for label in labels], "o-", label=method)
        for label, place in zip(labels, x, strict=True):
            axis.annotate(label.split("@")[1], (place, float(np.mean(delays[label]))), fontsize=7)
    axis.set_xscale("log")
    axis.set_xlabel(f"false stops per hour, measured in {hours:.1f} h (numbers: budget per hour)")
    axis.set_ylabel(f"delay after the touch\nat {CURVE_SPEED} m/s, ms (simulated)")
    axis.legend(fontsize=8)
    axis.grid(alpha=0.3)
    return svg_text(figure)


def sensitivity_figure(rows: Sequence[Row]) -> str:
    """Draw the mean deviation under each variant of the scene, at both ends of the speeds."""
    figure, axes = pyplot().subplots(1, len(SENSITIVITY_SPEEDS), figsize=(9, 3.6), sharey=True)
    names = list(VARIANTS)
    for axis, speed in zip(axes, SENSITIVITY_SPEEDS, strict=True):
        for number, method in enumerate((PUBLISHED, "default")):
            found = {row.case: row.value for row in rows
                     if (row.method, row.metric) == (method, "deviation_mean_mm")}  # fmt: skip
            values = np.array([found.get(f"{name}/{speed}") for name in names], float)
            axis.barh(np.arange(len(names)) + 0.4 * (number - 0.5), values, 0.4, label=method,
                      color=STYLES[method][1])  # fmt: skip
        axis.set_yticks(np.arange(len(names)), names, fontsize=8)
        axis.set_xlabel(f"mean deviation at {speed} m/s, mm (simulated)")
        axis.grid(alpha=0.3, axis="x")
    axes[0].invert_yaxis()
    axes[0].legend(fontsize=8)
    return svg_text(figure)


def figures(rows: Sequence[Row], approaches: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Return caption and SVG of every figure for which there are records."""
    drawn = [
        (
            "Detection deviation (circles, left) and overshoot (triangles, right) against the "
            "approach speed, preset typical, simulated. Solid: events; dashed: frames. frame_paper "
            "contains the paper's 135 ms, frame_sampling nothing but 32 fps.",
            speed_figure(rows),
        ),
        (
            "Events per millisecond around a collision (simulated); black: the true first touch.",
            trace_figure(approaches),
        ),
        (
            "Delay against false stops for several budgets; no false stop is drawn as half of one "
            "(simulated).",
            curve_figure(approaches, rows),
        ),
        (
            "Sensitivity: one thing changed at a time, preset typical (simulated). An empty bar: "
            "no approach was found within the patience.",
            sensitivity_figure(rows),
        ),
    ]
    return [(caption, svg) for caption, svg in drawn if svg]
