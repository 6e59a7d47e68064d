"""What the verbs share that publish a sensor live: until when, in which order, and the summary."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from spikingtac.cli.interrupt import ending_on_interrupt
from spikingtac.cli.messages import emit_json, remark, warn
from spikingtac.cli.options import ReadArgs

if TYPE_CHECKING:
    from spikingtac.ros2.feed import Feed, Pace
    from spikingtac.ros2.stream import Publisher, SensorStream

LOOK_S = 0.01
"""Time between two looks for a reader, s."""
ENDING_S = 0.1
"""Time for the last messages to leave before the topics end, s."""


@dataclass(frozen=True, kw_only=True)
class PublishArgs(ReadArgs):
    """Options of verbs that publish a sensor."""

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SOURCE")]
    """A camera's address, event file or recording folder, with --calibration; or tracks.npz."""
    calibration: Path | None = None
    """calibration.json of this sensor; make one with: spikingtac calibrate."""
    preset: str = "default"
    """Tracker: default, fast or paper, or a TOML file."""
    rate_hz: float | None = None
    """Frames per second; the preset's unless given."""
    force: Path | None = None
    """Force model: publish the wrench, too; make one with: spikingtac force fit."""
    without_events: bool = False
    """Do not publish the events."""
    wait_s: float = 0.0
    """Longest wait for a first reader of the field before the first frame, s."""
    seconds: float | None = None
    """Duration, s; without end unless given."""


def feed_of(args: PublishArgs) -> Feed:
    """Return the frames that are published."""
    from spikingtac.ros2.feed import FeedConfig, open_feed

    names = ("source", "calibration", "preset", "rate_hz", "force", "sensor", "strict")
    return open_feed(FeedConfig(**{name: getattr(args, name) for name in names}, tell=warn))


def publish_until(
    feed: Feed, stream: SensorStream, seconds: float | None, ready: Callable[[], None]
) -> dict[str, Any]:
    """Publish until the source ends, so many seconds of it are over, or Ctrl-C; return figures.

    Args:
        feed: The frames.
        stream: What publishes them.
        seconds: Length, s of data time; None is all of it.
        ready: Waits for whom shall not miss the first frame.
    """
    from spikingtac.ros2.feed import Pace
    from spikingtac.stream.real_time import exempt_from_collection

    exempt_from_collection()  # a collection in the middle would hold up 200 frames
    pace, stop, begun_s = Pace(), _Stop(), time.monotonic()
    try:
        ready()
        with ending_on_interrupt(feed.source, stop):
            _publish(feed, stream, pace, seconds, stop)
    except KeyboardInterrupt:
        stop.close()
    if stop.asked:
        remark("ended")
    time.sleep(ENDING_S)
    return {
        "seconds": round(time.monotonic() - begun_s, 3),
        "largest_lag_ms": round(1e3 * pace.largest_lag_s, 3),
        "sent_late_ms": pace.lateness_ms(),
        "messages": dict(sorted(stream.counts.items())),
        "anomalies": anomalies(feed),
    }


def wait_for_reader(publisher: Publisher, topic: str, wait_s: float) -> None:
    """Wait until somebody reads a topic, but not longer than ``wait_s``."""
    deadline_s = time.monotonic() + wait_s
    while not publisher.readers(topic) and time.monotonic() < deadline_s:
        time.sleep(LOOK_S)


def tell(found: dict[str, Any], *, as_json: bool) -> None:
    """Print what was published."""
    if as_json:
        emit_json(found)
        return
    told = ", ".join(f"{count} {name}" for name, count in found["messages"].items())
    remark(f"published {told}; at most {found['largest_lag_ms']:.0f} ms behind")


def anomalies(feed: Feed) -> dict[str, int]:
    """Return what was wrong with the events so far, by kind."""
    return {} if feed.source is None else dict(feed.source.losses.kinds())


class _Stop:
    """Ends the publishing of what cannot be closed, tracks and recordings, at the next frame.

    An interrupt in the middle of a message would end the process by the signal, not with 0.
    """

    asked = False

    def close(self) -> None:
        self.asked = True


def _publish(
    feed: Feed, stream: SensorStream, pace: Pace, seconds: float | None, stop: _Stop
) -> None:
    first_us: int | None = None
    for frame, wrench in feed.frames(stream, pace):
        stream.frame(frame, wrench, anomalies(feed))
        pace.sent(frame.t_us)
        first_us = frame.t_us if first_us is None else first_us
        if stop.asked:
            return
        if seconds is not None and frame.t_us - first_us >= seconds * 1e6:
            return
