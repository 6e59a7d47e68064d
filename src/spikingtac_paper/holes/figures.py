"""Pictures of the hole experiment: every hole with its confidence ellipse, errors by hole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from spikingtac.sim.rig.wall_calibration import SIGMAS_MM, touched_of
from spikingtac_paper.harness.published import HOLE_ERRORS_MM
from spikingtac_paper.harness.rows import Row
from spikingtac_paper.harness.svg import pyplot, svg_text
from spikingtac_paper.holes.jobs import RADII_MM
from spikingtac_paper.holes.scoring import METHODS, HoleScore, score

SIGMA_MM = SIGMAS_MM["rep028"]
CASE = "rep028"
TITLES = {"position_rmse_mm": "error of the centre", "radius_rmse_mm": "error of the radius"}
METRICS = tuple(TITLES)
TICKS_MM = (0.003, 0.01, 0.03, 0.1, 0.3)
"""Ticks of the axis of the errors, mm."""


def plate_figure(
    records: Sequence[Mapping[str, Any]], calibration: Mapping[str, Any], method: str
) -> str:
    """Draw the ten holes of a plate: truth, contacts, estimate, confidence ellipse; SVG.

    Args:
        records: The searches of one seed.
        calibration: The calibration of this seed.
        method: Name of the method.
    """
    figure, axes = pyplot().subplots(2, 5, figsize=(11, 5.8), layout="constrained")
    for axis in axes.flat:
        axis.set_axis_off()
    for record in records:
        axis = axes.flat[record["hole"]]
        _draw_panel(axis, record, method, score(method, record, calibration, SIGMA_MM))
    seed = calibration["seed"]
    figure.suptitle(
        f"{method}, seed {seed} (simulated, repeatability {SIGMA_MM:g} mm)", fontsize=10
    )
    _draw_legend(figure, list(axes.flat))
    return svg_text(figure)


def _draw_panel(axis: Any, record: Mapping[str, Any], method: str, found: HoleScore) -> None:
    from spikingtac.plots.hole import HolePicture, draw_hole

    rule = METHODS[method]
    stored = record[rule.style]
    shown = stored["used"][: rule.contacts] or range(len(stored["touches"]))
    reading = [touched_of(stored["touches"][number], SIGMA_MM).reading_mm for number in shown]
    picture = HolePicture(
        circle=found.circle,
        reading_mm=np.array(reading, np.float64).reshape(-1, 2),
        true_center_mm=found.center_mm,
        true_radius_mm=found.radius_mm,
    )
    draw_hole(axis, picture)
    off = 1000.0 * found.error_mm
    label = "no estimate"
    if found.circle is not None:
        label = (
            f"off by {np.hypot(*off[:2]):.0f} µm, R by {off[2]:+.0f} µm\n"
            f"centre × {picture.center_factor:g}, residuals × {picture.residual_factor:g}"
        )
    axis.set_title(f"hole {found.hole + 1}, R {found.radius_mm:g} mm\n{label}", fontsize=8)
    axis.set_axis_off()


def _draw_legend(figure: Any, axes: Sequence[Any]) -> None:
    """Put one legend below all panels; the factors stand above each."""
    known: dict[str, Any] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            known.setdefault(label.split(" × ")[0].split(", R ")[0], handle)
    figure.legend(known.values(), known.keys(), loc="outside lower center", ncols=7, fontsize=8)


def error_figure(rows: Sequence[Row], methods: Sequence[str]) -> str:
    """Draw position and radius RMSE over the holes, beside the paper's errors; SVG."""
    figure, axes = pyplot().subplots(1, 2, figsize=(10, 4.2), sharey=True, layout="constrained")
    place = np.arange(len(RADII_MM))
    printed = np.abs(HOLE_ERRORS_MM).T
    for axis, metric, paper in zip(axes, METRICS, printed, strict=True):
        axis.plot(place, paper, "D", color="#8c959f", ms=5, label="paper (measured)")
        for method in methods:
            found = {row.case: row for row in rows if (row.method, row.metric) == (method, metric)}
            drawn = [found[f"{CASE}/hole-{hole + 1}"].value for hole in place]
            values = [np.nan if value is None else value for value in drawn]
            axis.plot(place, values, "o-", ms=4, label=method)
        axis.set_yscale("log")
        axis.set_yticks(TICKS_MM, [f"{tick:g}" for tick in TICKS_MM])
        axis.set_xticks(place, [f"{radius:g}" for radius in RADII_MM], fontsize=7)
        axis.set_xlabel("radius of the hole, mm")
        axis.set_title(TITLES[metric], fontsize=10)
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("RMSE (simulated), |error| (paper), mm")
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8
    )
    return svg_text(figure)
