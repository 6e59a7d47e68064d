"""What a view is tracked into without a page: figures, pictures, animations, messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spikingtac.atomic_files import replacing, require_free
from spikingtac.errors import ConfigError, SpikingTacError, import_extra
from spikingtac.plots.figure import PICTURE_ENDINGS, drawn, save_gif
from spikingtac.plots.moments import DPI, PANEL, SensorDrawing
from spikingtac.ros2.messages import NS_PER_US, definition, encode, header, ros_type
from spikingtac.ros2.stream import SensorInfo, SensorStream
from spikingtac.stream.reader import no_longer_than
from spikingtac.types import MarkerFrame
from spikingtac.viewer.playback import Playback
from spikingtac.viewer.record import Record, picture_of
from spikingtac.viewer.source import EventStore, ViewSource
from spikingtac.viewer.video import write_mp4

if TYPE_CHECKING:
    from PIL.Image import Image

ENDINGS = (".mcap", ".mp4", ".gif", *PICTURE_ENDINGS)

# Grey values of a pixel without event, and of one whose last event was ON or OFF.
GREYS = np.array([128, 255, 0], np.uint8)

# Time between two pictures, ms, colours of a palette, and what writes them. GIF counts in 10 ms,
# and browsers slow down what is below 20 ms; a video has 25 pictures a second, as in film.
ANIMATIONS = {".gif": (50, 32, save_gif), ".mp4": (40, 256, write_mp4)}

# Moments of a course, more than a figure has pixels, and the least time between two, us.
LOOKS, LEAST_STEP_US = 4_000, 10_000
MESSAGE_US = 10_000  # Span of an MCAP message, us: what a display needs and a bag likes.
IMAGE = "/tactile/image"  # Topic of the events as images.
BUDGET_S = 3600.0  # Time for one step of an export, s: none is cut off.
SIDE_IN = 3.4  # Side of an animation's picture, inches.
LONGEST_S = 60.0  # Longest animation, s: a GIF of a minute has tens of megabytes already.


@contextmanager
def tracked(
    view: ViewSource, seconds: float | None, on_frame: Callable[[MarkerFrame], object]
) -> Iterator[tuple[Playback, int]]:
    """Open a view that is tracked as fast as the machine can; its files go with the context.

    Args:
        view: What is exported.
        seconds: Length from the beginning, s; None is all of it.
        on_frame: Takes every estimate.

    Yields:
        What tracks it, and the end of the stretch, us.

    Raises:
        ConfigError: The source does not end by itself and no length was given.
    """
    if seconds is None and not view.ends:
        raise ConfigError("this source does not end by itself; give a length: --seconds N")
    # A simulation may be slower than the time that it tells.
    live = None if view.ends or view.simulated else view.source
    with no_longer_than(live, seconds), closing(EventStore(view.source)) as store:
        asked_us = float("inf") if seconds is None else store.t_start_us + round(seconds * 1e6)
        if view.ends:
            store.extend_to(float("inf"))
            asked_us = min(asked_us, store.t_end_us)
        yield Playback(store, view, on_frame), int(asked_us)


def steps(playback: Playback, step_us: int, end_us: int) -> Iterator[int]:
    """Track on step by step to the end; yield how far each step went, us.

    A silence that is too long to be filled counts as one step.
    """
    while True:
        before_us = playback.position_us
        target_us = max(before_us + step_us, playback.resumes_us(before_us + step_us) or 0)
        playback.aim(min(target_us, end_us))
        playback.work(BUDGET_S)
        if playback.position_us == before_us:
            return
        yield playback.position_us - before_us


def export(view: ViewSource, path: str | Path, *, seconds: float | None = None) -> int:
    """Track a view into a file; return the number of messages or pictures.

    Args:
        view: From :func:`spikingtac.viewer.opening.open_view`.
        path: ``.mcap`` (ROS 2 schemas), ``.mp4``, ``.gif``, or one picture: ``.png``, ``.svg``,
            ``.pdf``.
        seconds: Length of the stretch from its beginning, s; None is all of it.

    Raises:
        ConfigError: The ending is another, the folder does not exist, the source does not end and
            no length was given, or nothing was tracked.
        MissingExtraError: The format needs an extra.
    """
    ending = require_free(path, True, ENDINGS)
    with replacing(path) as partial:
        if ending in PICTURE_ENDINGS:
            summarize(view, seconds=seconds, picture=partial)
            return 1
        if ending == ".mcap":
            return _export_mcap(view, partial, seconds)
        frame_ms, colors, save = ANIMATIONS[ending]
        pictures = _draw_stretch(view, frame_ms, colors, seconds)
        save(pictures, frame_ms, partial)
        return len(pictures)


def summarize(
    view: ViewSource, *, seconds: float | None = None, picture: Path | None = None
) -> dict[str, Any]:
    """Track a view as fast as the machine, or a live source, can; return its figures.

    Args:
        view: What is tracked, with its calibration or without.
        seconds: Length of the stretch from its beginning, s; None is all of it.
        picture: File for the moment of largest displacement beside the whole course, or None.

    Raises:
        ConfigError: The source does not end and no length was given, or it holds nothing.
        SpikingTacError: A live source failed; the picture shows what came before.
    """
    ended: BaseException | None = None
    record = Record()
    with tracked(view, seconds, record.estimate) as (playback, end_us):
        step_us = max((end_us - playback.position_us) // LOOKS, LEAST_STEP_US)
        try:
            for _ in steps(playback, step_us, end_us):
                record.take(playback)
        except (SpikingTacError, OSError, RuntimeError, KeyboardInterrupt) as error:
            if view.ends:
                raise
            ended = error
        if picture is not None:
            record.save_picture(picture, playback)
        summary = record.summary(playback)
    if ended is not None and not isinstance(ended, KeyboardInterrupt):
        raise ended
    return summary


class _McapPublisher:
    """Writes messages into a file; it is a :class:`~spikingtac.ros2.messages.Publisher`.

    Args:
        path: The file.

    Attributes:
        messages: Messages written so far.

    Raises:
        MissingExtraError: The extra ``[formats]`` is not installed.
    """

    def __init__(self, path: Path) -> None:
        self._writer = import_extra("mcap.writer", "MCAP", "formats").Writer(str(path))
        self._writer.start(profile="ros2", library="spikingtac")
        self._channels: dict[str, tuple[int, str]] = {}
        self.messages, self.close = 0, self._writer.finish

    def advertise(self, topic: str, message: str, *, state: bool = False) -> None:
        """Announce a topic."""
        text = definition(message).encode()
        schema = self._writer.register_schema(ros_type(message), "ros2msg", text)
        self._channels[topic] = self._writer.register_channel(topic, "cdr", schema), message

    def publish(self, topic: str, values: Mapping[str, Any], t_ns: int) -> None:
        """Append a message, stamped with its data time."""
        channel, message = self._channels[topic]
        self._writer.add_message(channel, t_ns, encode(message, values), t_ns, self.messages)
        self.messages += 1

    def readers(self, topic: str) -> int:
        """Return 1: the file."""
        return 1


def _export_mcap(view: ViewSource, path: Path, seconds: float | None) -> int:
    """Track a view into MCAP with ROS 2 schemas: what `ros2` publishes, and the events as images.

    ROS 2 tools, Foxglove and Rerun read it without ROS being installed here.

    Raises:
        MissingExtraError: The extra ``[formats]`` is not installed.
        ConfigError: As of :func:`export`.
    """
    calibration = view.calibration
    sensor = SensorInfo(
        calibration.reference_px,
        calibration.grid,
        calibration.px_per_mm,
        name=view.label,
        has_events=True,
    )
    with closing(_McapPublisher(path)) as publisher:
        stream = SensorStream(publisher, sensor, field_hz=1e6 / MESSAGE_US, clock_ns=None)
        publisher.advertise(IMAGE, "sensor_msgs/Image")
        with tracked(view, seconds, stream.frame) as (playback, last_us):
            store = playback.store
            for advanced_us in steps(playback, MESSAGE_US, last_us):
                now_us = playback.position_us
                # The events after the last whole step belong to the last message.
                end_us = last_us if advanced_us < MESSAGE_US else now_us
                stream.events(store.between(now_us - advanced_us, end_us))
                grey = GREYS[picture_of(playback).image]
                image = {
                    "header": header(now_us * NS_PER_US),
                    "height": grey.shape[0],
                    "width": grey.shape[1],
                    "encoding": "mono8",
                    "step": grey.shape[1],
                    "data": grey.tobytes(),
                }
                publisher.publish(IMAGE, image, now_us * NS_PER_US)
    return publisher.messages


def _draw_stretch(
    view: ViewSource, frame_ms: int, most_colors: int, seconds: float | None
) -> list[Image]:
    """Track a view and draw it at a regular rate, with a palette for each picture.

    Args:
        view: What is drawn.
        frame_ms: Time between two pictures, ms.
        most_colors: Colours of a palette; a picture keeps one byte for each pixel.
        seconds: Length of the stretch from its beginning, s; None is all of it, a minute at most.

    Raises:
        ConfigError: As of :func:`export`.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(SIDE_IN, SIDE_IN), dpi=DPI, facecolor=PANEL, layout="constrained")
    canvas, axes = FigureCanvasAgg(figure), figure.add_subplot()
    drawing: SensorDrawing | None = None
    pictures: list[Image] = []
    most = int(min(seconds or LONGEST_S, LONGEST_S) * 1000 / frame_ms)
    with tracked(view, seconds, lambda _: None) as (playback, end_us):
        for _ in steps(playback, frame_ms * 1000, end_us):
            if len(pictures) == most or playback.state.frame is None:
                break
            picture = picture_of(playback)
            if drawing is None:
                drawing = SensorDrawing(axes, picture)
                canvas.draw()
                figure.set_layout_engine("none")  # what was laid out once stays
            drawing.show(picture)
            pictures.append(drawn(canvas, most_colors))
    if not pictures:
        raise ConfigError(f"{view.label}: too short, nothing was tracked")
    return pictures
