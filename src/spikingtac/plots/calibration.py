"""A picture of a calibration: the markers as they look, doubtful ones in another colour."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.plots.theme import new_figure, style_axes
from spikingtac.plots.tracks import save_figure

MARGIN = 0.09  # Height of title and legend over the figure's width.

# Colour and line of a marker's circle, by what is known of it; told apart by deuteranopes, too
# (Okabe and Ito, 2008).
STATUS: dict[str, tuple[str, Literal["-", "--"]]] = {
    "good": ("#009e73", "-"),
    "doubtful": ("#e69f00", "-"),
    "expected": ("#cc79a7", "--"),
}

LEVELS = {"white": (0.15, 0.85), "dark": (0.85, 0.15)}  # Grey of the ground and of the markers.


def save_calibration_plot(calibration: Calibration, path: str | Path) -> None:
    """Draw the markers and circles around them, and write the picture.

    Args:
        calibration: What to draw.
        path: File to write; its ending chooses the format.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Circle

    width, height = calibration.size
    figure, theme = new_figure("light", "double", height / width + MARGIN)
    axes = figure.add_subplot()
    style_axes(axes, theme)
    axes.imshow(picture(calibration), cmap="gray", vmin=0.0, vmax=1.0)
    status = marker_status(calibration)
    for marker, center in enumerate(calibration.reference_px):
        color, line = STATUS[status[marker]]
        radius_px = float(calibration.radius_px[marker])
        place = (float(center[0]), float(center[1]))
        axes.add_patch(
            Circle(place, radius_px, fill=False, color=color, linestyle=line, linewidth=1.6)
        )
        axes.annotate(str(marker), place, color=color, ha="center", va="center", size=7)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xlabel="x (px)", ylabel="y (px)")
    axes.set_aspect("equal")
    shape = calibration.grid or ("free",)
    said = calibration.provenance.get("quality")
    axes.set_title(
        f"{'x'.join(map(str, shape))} {calibration.polarity} markers, radius "
        f"{float(np.mean(calibration.radius_px)):.2f} px" + (f", quality {said}" if said else "")
    )
    handles = [
        Line2D([], [], color=color, linestyle=line, label=f"{name}: {status.count(name)}")
        for name, (color, line) in STATUS.items()
        if name in status
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    save_figure(figure, path)


def marker_status(calibration: Calibration) -> list[str]:
    """Return for each marker whether it is good, doubtful, or only expected from the others."""
    doubtful = set(calibration.provenance.get("doubtful", []))
    measured = calibration.marker_measured
    missing = set(calibration.provenance.get("missing", []))
    if measured is not None:
        missing = set(np.flatnonzero(~measured).tolist())
    return [
        "expected" if marker in missing else "doubtful" if marker in doubtful else "good"
        for marker in range(len(calibration.radius_px))
    ]


def picture(calibration: Calibration) -> NDArray[np.float64]:
    """Return ``(height, width)`` grey levels 0 to 1 of the sensor as its calibration has it."""
    width, height = calibration.size
    y, x = np.mgrid[:height, :width]
    cover = np.zeros((height, width))
    edges = calibration.marker_edge_px
    for marker, (cx, cy) in enumerate(calibration.reference_px):
        edge_px = calibration.edge_px or 0.5 if edges is None else float(edges[marker])
        q_px = np.hypot(x - cx, y - cy) - calibration.radius_px[marker]
        cover = np.maximum(cover, 1.0 / (1.0 + np.exp(np.clip(q_px / edge_px, -40.0, 40.0))))
    ground, marker_level = LEVELS[calibration.polarity]
    return ground + (marker_level - ground) * cover
