"""A tracked stretch as an animated GIF, for papers and pages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.errors import ConfigError
from spikingtac.plots.summary import DPI, PANEL, Picture, draw_sensor
from spikingtac.viewer.export.stretch import Stretch, open_stretch
from spikingtac.viewer.session.layers import OFF_CODE, activity, unpack, view_size, view_step
from spikingtac.viewer.session.source import ViewSource

FRAME_MS = 50
"""Twenty frames per second: GIF counts in 10 ms, and browsers slow down what is below 20 ms."""
SIDE_IN = 3.4
LONGEST_S = 60.0
"""A GIF of a minute has tens of megabytes already."""
MOST_COLORS = 32


def export_gif(view: ViewSource, path: str | Path, *, seconds: float | None = None) -> int:
    """Track a view and write what a page would show; return the number of pictures.

    Args:
        view: From :func:`spikingtac.viewer.session.opening.open_view_source`.
        path: File to write.
        seconds: Length of the stretch from its beginning; None is all of it, a minute at most.

    Raises:
        ConfigError: The source does not end and no length was given, or nothing was tracked.
    """
    pictures = []
    with open_stretch(view, seconds) as stretch:
        for _ in range(int(min(seconds or LONGEST_S, LONGEST_S) * 1000 / FRAME_MS)):
            if not stretch.advance(FRAME_MS * 1000) or stretch.playback.frame is None:
                break
            pictures.append(_picture(stretch))
    if not pictures:
        raise ConfigError(f"{view.label}: too short, nothing was tracked")
    first, *rest = pictures
    first.save(path, save_all=True, append_images=rest, duration=FRAME_MS, loop=0, optimize=True)
    return len(pictures)


def _picture(stretch: Stretch) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    frame, store = stretch.playback.frame, stretch.playback.store
    calibration = stretch.view.calibration
    assert frame is not None
    size, step = view_size(store.size), view_step(store.size)
    codes = unpack(activity(stretch.exposed()), size)
    figure = Figure(figsize=(SIDE_IN, SIDE_IN), dpi=DPI, facecolor=PANEL, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    draw_sensor(
        figure.add_subplot(),
        Picture(
            image=np.where(codes == 0, 0, np.where(codes < OFF_CODE, 1, 2)).astype(np.uint8),
            reference_px=calibration.reference_px / step,
            position_px=frame.position_px / step,
            radius_px=calibration.radius_px / step,
            t_s=(frame.t_us - store.t_start_us) / 1e6,
        ),
    )
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    return picture.quantize(MOST_COLORS, dither=Image.Dither.NONE)
