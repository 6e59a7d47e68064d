"""A stretch of a view that is tracked as fast as the machine can, and its pictures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from spikingtac.errors import ConfigError
from spikingtac.plots.summary import DPI, PANEL, SensorDrawing
from spikingtac.types import EventPacket
from spikingtac.viewer.record import EXPOSURE_US, Record, picture_of
from spikingtac.viewer.replay.event_store import EventStore
from spikingtac.viewer.replay.playback import Playback
from spikingtac.viewer.source import ViewSource

if TYPE_CHECKING:
    from PIL.Image import Image

US_PER_S = 1_000_000
BUDGET_S = 3600.0  # Time for one step of an export, s: none is cut off.
SIDE_IN = 3.4
LONGEST_S = 60.0  # A GIF of a minute has tens of megabytes already.


class Stretch:
    """A view that is tracked from its beginning to a given end.

    Args:
        view: What is exported.
        store: Its events.
        end_us: End of the stretch, us.

    Attributes:
        record: What was tracked.
        playback: Tracks it.
    """

    def __init__(self, view: ViewSource, store: EventStore, end_us: int) -> None:
        self.view, self.end_us, self.record = view, end_us, Record()
        self.playback = Playback(
            store,
            lambda: view.make_tracker(view.config),
            view.make_detector,
            rate_hz=view.rate_hz,
            on_frame=self.record.estimate,
        )

    def advance(self, step_us: int) -> int:
        """Track on by a step, at most to the end; return how far it went, us.

        A silence that is too long to be filled counts as one step.
        """
        before_us = self.playback.position_us
        target_us = max(before_us + step_us, self.playback.resumes_us(before_us + step_us) or 0)
        self.playback.aim(min(target_us, self.end_us))
        self.playback.work(BUDGET_S)
        return self.playback.position_us - before_us

    def exposed(self) -> EventPacket:
        """Return the events of the last exposure."""
        now_us = self.playback.position_us
        return self.playback.store.between(now_us - EXPOSURE_US, now_us)


@contextmanager
def open_stretch(view: ViewSource, seconds: float | None) -> Iterator[Stretch]:
    """Open a stretch of a view; its temporary files go with the context.

    Args:
        view: What is exported.
        seconds: Length from the beginning; None is all of it.

    Raises:
        ConfigError: The source does not end by itself and no length was given.
    """
    if seconds is None and not view.ends:
        raise ConfigError("this source does not end by itself; give a length: --seconds N")
    store = EventStore(view.source)
    try:
        if view.ends:
            store.extend_to_end()
        end_us = store.t_end_us
        if seconds is not None:
            asked_us = store.t_start_us + round(seconds * US_PER_S)
            end_us = min(asked_us, end_us) if view.ends else asked_us
        yield Stretch(view, store, end_us)
    finally:
        store.close()
        view.close()


def draw_stretch(
    view: ViewSource, frame_ms: int, most_colors: int, seconds: float | None
) -> list[Image]:
    """Track a view and draw it at a regular rate, with a palette for each picture.

    Args:
        view: What is drawn.
        frame_ms: Time between two pictures, ms.
        most_colors: Colours of a palette; a picture keeps one byte for each pixel.
        seconds: Length of the stretch from its beginning; None is all of it, a minute at most.

    Raises:
        ConfigError: As of :func:`export`.
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
        picture = picture_of(stretch.view, stretch.playback)
        if drawing is None:
            drawing = SensorDrawing(axes, picture)
            canvas.draw()
            figure.set_layout_engine("none")  # what was laid out once stays
        else:
            drawing.show(picture)
        canvas.draw()
        yield Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
