"""Pictures of the hole experiment: every hole with its confidence ellipse, errors by hole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from spikingtac.experiments.figures import svg_text
from spikingtac.experiments.hole_scoring import METHODS, HoleScore, score
from spikingtac.experiments.hole_touching import RADII_MM, SIGMAS_MM, touched_of
from spikingtac.experiments.published import HOLE_ERRORS_MM
from spikingtac.experiments.rows import Row

SIGMA_MM = SIGMAS_MM["rep028"]
CASE = "rep028"
MAGNIFIED = 20.0
"""How much larger than true the regions and errors of the centre are drawn."""
METRICS = ("position_rmse_mm", "radius_rmse_mm")
PLANE_REGION = 5.991
"""95 % quantile of chi-squared with two degrees of freedom: the centre alone."""


def plate_figure(
    records: Sequence[Mapping[str, Any]], calibration: Mapping[str, Any], method: str
) -> str:
    """Draw the ten holes of a plate: truth, contacts, estimate, confidence ellipse; SVG.

    Args:
        records: The searches of one seed.
        calibration: Of that seed.
        method: Which method.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(2, 5, figsize=(11, 5.2))
    for axis in axes.flat:
        axis.set_axis_off()
    for record in records:
        axis = axes.flat[record["hole"]]
        _draw_hole(axis, record, method, score(method, record, calibration, SIGMA_MM))
    figure.tight_layout()
    return svg_text(figure)


def _draw_hole(axis: Any, record: Mapping[str, Any], method: str, found: HoleScore) -> None:
    from matplotlib.patches import Circle as Disc
    from matplotlib.patches import Ellipse

    x, y = found.center_mm
    axis.add_patch(Disc((x, y), found.radius_mm, fill=False, ec="#cf222e", lw=1.2))
    how = METHODS[method]
    kept = record[how.style]
    for number in kept["used"][: how.contacts]:
        axis.plot(*touched_of(kept["touches"][number], SIGMA_MM).reading_mm, "k.", ms=3)
    if found.circle is not None:
        circle = found.circle
        axis.add_patch(
            Disc(tuple(circle.center_mm), circle.radius_mm, fill=False, ec="#0969da", ls="--")
        )
        value, vector = np.linalg.eigh(circle.covariance_mm2[:2, :2])
        width, height = 2.0 * MAGNIFIED * np.sqrt(PLANE_REGION * value)
        turn = float(np.degrees(np.arctan2(vector[1, 0], vector[0, 0])))
        middle = found.center_mm + MAGNIFIED * found.error_mm[:2]
        axis.add_patch(Ellipse(tuple(middle), width, height, angle=turn, fc="#0969da", alpha=0.3))
        axis.plot(x, y, "+", color="#cf222e", ms=7)
    reach = 1.15 * found.radius_mm
    axis.set(xlim=(x - reach, x + reach), ylim=(y - reach, y + reach), aspect="equal")
    off = 1000.0 * found.error_mm
    told = "no estimate" if found.circle is None else f"{np.hypot(*off[:2]):.0f} / {off[2]:+.0f} um"
    axis.set_title(f"R {found.radius_mm:g} mm: {told}", fontsize=8)


def error_figure(rows: Sequence[Row], methods: Sequence[str]) -> str:
    """Draw position and radius RMSE over the holes, beside the paper's errors; SVG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(10, 3.6), sharey=True)
    place = np.arange(len(RADII_MM))
    printed = np.abs(HOLE_ERRORS_MM).T
    for axis, metric, paper in zip(axes, METRICS, printed, strict=True):
        axis.bar(place, paper, color="#d8dee4", label="paper")
        for method in methods:
            found = {row.case: row for row in rows if (row.method, row.metric) == (method, metric)}
            drawn = [found[f"{CASE}/hole-{hole + 1}"].value for hole in place]
            values = [np.nan if value is None else value for value in drawn]
            axis.plot(place, values, "o-", ms=4, label=method)
        axis.set_xticks(place, [f"{radius:g}" for radius in RADII_MM], fontsize=7)
        axis.set_xlabel("radius of the hole, mm")
        axis.set_ylabel(metric.replace("_mm", "").replace("_", " ") + ", mm")
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=7)
    figure.tight_layout()
    return svg_text(figure)
