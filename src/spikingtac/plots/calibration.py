"""A picture of a calibration: circles and numbers over the pixels' steps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from spikingtac.calibration.sensor_calibration import Calibration

WIDTH_IN = 7.0
"""Width of the picture, inches."""


def save_calibration_plot(calibration: Calibration, path: str | Path) -> None:
    """Draw the reference circles over the map of ON steps and write the picture.

    Missing markers are dashed. Where no steps are stored, the ground is plain.

    Args:
        calibration: What to draw.
        path: File to write; its ending chooses the format.
    """
    width, height = calibration.size
    figure = Figure(figsize=(WIDTH_IN, WIDTH_IN * height / width), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    steps = calibration.step_on_map
    if steps is not None:
        shown = axes.imshow(steps, cmap="viridis")
        figure.colorbar(shown, ax=axes, label="share of the full swing per ON event", shrink=0.8)
    missing = set(calibration.provenance.get("missing", []))
    for marker, center in enumerate(calibration.reference_px):
        lost = marker in missing
        circle = Circle(
            (float(center[0]), float(center[1])),
            float(calibration.radius_px[marker]),
            fill=False,
            color="red" if lost else "white" if steps is not None else "black",
            linestyle="--" if lost else "-",
        )
        axes.add_patch(circle)
        color = "white" if steps is not None else "black"
        axes.annotate(str(marker), tuple(center), color=color, ha="center", va="center", size=7)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xlabel="x, px", ylabel="y, px")
    axes.set_aspect("equal")
    rows, columns = calibration.grid
    radius_px = float(np.mean(calibration.radius_px))
    axes.set_title(f"{rows}x{columns} markers, radius {radius_px:.2f} px")
    figure.savefig(path, dpi=120)
