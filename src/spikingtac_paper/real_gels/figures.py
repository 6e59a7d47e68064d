"""The figures of the experiment on real gels, as SVG text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.types import EventPacket
from spikingtac_paper.harness.svg import pyplot, svg_text
from spikingtac_paper.real_gels.scoring import Plateaus, matched, standing_px
from spikingtac_paper.trials.prediction import Prediction

COLOURS = ("#0969da", "#bc4c00", "#8250df", "#1a7f37")
"""Colours of the methods, in their order."""

ON_COLOUR, OFF_COLOUR = "#cf222e", "#0550ae"


def plateau_figure(
    prediction: Prediction,
    plateaus: Plateaus,
    radius_px: NDArray[np.float64],
    burst: EventPacket,
    plateau: int,
) -> str:
    """Draw the events of a burst, the standing places after it, and the estimates.

    Args:
        prediction: Of one method.
        plateaus: The reference.
        radius_px: ``(n,)`` calibrated radii, px.
        burst: The events of the burst before the plateau.
        plateau: Index of the plateau.
    """
    from matplotlib.patches import Circle

    width, height = burst.size
    figure, axis = pyplot().subplots(figsize=(7.0, 7.0 * height / width + 0.4))
    for kind, colour in ((True, ON_COLOUR), (False, OFF_COLOUR)):
        chosen = burst.p == kind
        axis.plot(burst.x[chosen], burst.y[chosen], ".", ms=1.2, color=colour, alpha=0.35)
    estimated_px = standing_px(prediction, plateaus)[:, plateau]
    own, other = matched(prediction.reference_px, plateaus.rest_px)
    for marker, known in zip(own.tolist(), other.tolist(), strict=True):
        place_x, place_y = plateaus.place_px[known, plateau].tolist()
        rest_x, rest_y = prediction.reference_px[marker].tolist()
        x, y = estimated_px[marker].tolist()
        radius = float(radius_px[marker])
        axis.add_patch(Circle((place_x, place_y), radius, fill=False, lw=1.2, color="#57606a"))
        arrow = {"arrowstyle": "->", "lw": 1.0}
        axis.annotate("", xy=(x, y), xytext=(rest_x, rest_y), arrowprops=arrow)
        axis.plot(x, y, "+", ms=6, color="black")
    axis.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    axis.set(xlabel="x, px", ylabel="y, px")
    return svg_text(figure)


def course_figure(
    predictions: Mapping[str, Prediction], plateaus: Plateaus, methods: tuple[str, ...]
) -> str:
    """Draw the displacement of the marker that moves most over time, one curve per method.

    Args:
        predictions: Method -> estimates.
        plateaus: The reference.
        methods: Curves, in order; those without estimates are left out.
    """
    shown = [name for name in methods if name in predictions]
    moved_px = np.linalg.norm(plateaus.displacement_px(), axis=2)
    known = int(moved_px.max(axis=1).argmax())
    figure, axis = pyplot().subplots(figsize=(8.0, 3.0))
    last_s = max(_seconds(predictions[name])[-1] for name in shown)
    _draw_reference(axis, plateaus, moved_px[known], last_s)
    for name, colour in zip(shown, COLOURS, strict=False):
        prediction = predictions[name]
        own, other = matched(prediction.reference_px, plateaus.rest_px)
        marker = own[other == known]
        if len(marker):
            at = int(marker[0])
            course_px = prediction.detected_px[:, at] - prediction.reference_px[at]
            axis.plot(_seconds(prediction), np.linalg.norm(course_px, axis=1), lw=0.9,
                      color=colour, label=name)  # fmt: skip
    axis.set(xlabel="time, s", ylabel="displacement, px", xlim=(0.0, last_s))
    axis.legend(frameon=False, ncols=len(shown) + 1, fontsize=8)
    figure.tight_layout()
    return svg_text(figure)


def _draw_reference(
    axis: Any, plateaus: Plateaus, moved_px: NDArray[np.float64], last_s: float
) -> None:
    for index, (start_us, end_us) in enumerate(
        zip(plateaus.start_us, plateaus.end_us, strict=True)
    ):
        end_s = last_s if end_us < 0 else end_us * 1e-6
        axis.plot([start_us * 1e-6, end_s], [moved_px[index]] * 2, lw=3.5, color="#8c959f",
                  label="reference" if index == 0 else None)  # fmt: skip


def _seconds(prediction: Prediction) -> NDArray[np.float64]:
    return (prediction.t_us - prediction.t_us[0]) * 1e-6
