"""The pictures of an animation: what a page would show of a tracked stretch, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from spikingtac.errors import ConfigError
from spikingtac.plots.summary import DPI, PANEL, Picture, SensorDrawing
from spikingtac.viewer.export.stretch import Stretch, open_stretch
from spikingtac.viewer.session.layers import OFF_CODE, activity, unpack, view_size, view_step
from spikingtac.viewer.session.source import ViewSource

if TYPE_CHECKING:
    from PIL.Image import Image

SIDE_IN = 3.4
LONGEST_S = 60.0
"""A GIF of a minute has tens of megabytes already."""


def draw_stretch(
    view: ViewSource, frame_ms: int, most_colors: int, seconds: float | None
) -> list[Image]:
    """Track a view and draw it at a regular rate, with a palette for each picture.

    Args:
        view: From :func:`spikingtac.viewer.session.opening.open_view_source`.
        frame_ms: Time between two pictures, ms.
        most_colors: Colours of a palette; a picture keeps one byte for each pixel.
        seconds: Length of the stretch from its beginning; None is all of it, a minute at most.

    Raises:
        ConfigError: The source does not end and no length was given, or nothing was tracked.
    """
    from PIL.Image import Dither

    with open_stretch(view, seconds) as stretch:
        pictures = [
            picture.quantize(most_colors, dither=Dither.NONE)
            for picture in _pictures(stretch, frame_ms, seconds)
        ]
    if not pictures:
        raise ConfigError(f"{view.label}: too short, nothing was tracked")
    return pictures


def _pictures(stretch: Stretch, frame_ms: int, seconds: float | None) -> Iterator[Image]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    figure = Figure(figsize=(SIDE_IN, SIDE_IN), dpi=DPI, facecolor=PANEL, layout="constrained")
    canvas, axes = FigureCanvasAgg(figure), figure.add_subplot()
    drawing: SensorDrawing | None = None
    for _ in range(int(min(seconds or LONGEST_S, LONGEST_S) * 1000 / frame_ms)):
        if not stretch.advance(frame_ms * 1000) or stretch.playback.frame is None:
            return
        if drawing is None:
            drawing = SensorDrawing(axes, picture_of(stretch))
            canvas.draw()
            figure.set_layout_engine("none")  # what was laid out once stays
        else:
            drawing.show(picture_of(stretch))
        canvas.draw()
        yield Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])


def picture_of(stretch: Stretch) -> Picture:
    """Return what a page would show now; something was tracked."""
    frame, store = stretch.playback.frame, stretch.playback.store
    calibration = stretch.view.calibration
    assert frame is not None
    size, step = view_size(store.size), view_step(store.size)
    codes = unpack(activity(stretch.exposed()), size)
    return Picture(
        image=np.where(codes == 0, 0, np.where(codes < OFF_CODE, 1, 2)).astype(np.uint8),
        reference_px=calibration.reference_px / step,
        position_px=frame.position_px / step,
        radius_px=calibration.radius_px / step,
        t_s=(frame.t_us - store.t_start_us) / 1e6,
    )
