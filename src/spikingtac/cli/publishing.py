"""What the verbs share that publish a sensor live: until when, in which order, and the summary."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from spikingtac.cli.interrupt import ending_on_interrupt
from spikingtac.cli.messages import remark, tell, warn
from spikingtac.cli.options import TrackerArgs
from spikingtac.errors import ConfigError

if TYPE_CHECKING:
    from spikingtac.ros2.feed import Feed, Pace
    from spikingtac.ros2.stream import Publisher, SensorStream

LOOK_S = 0.01  # Time between two looks for a reader, s.
ENDING_S = 0.1  # Time for the last messages to leave before the topics end, s.


@dataclass(frozen=True, kw_only=True)
class PublishArgs(TrackerArgs):
    """Options of verbs that publish a sensor."""

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SOURCE")]
    """A camera's address, event file or recording folder, with --calibration; or tracks.npz."""
    force: Path | None = None
    """Force model: publish the wrench, too; make one with: spikingtac force fit."""
    without_events: bool = False
    """Do not publish the events."""
    wait_s: float = 0.0
    """Longest wait for a first reader of the field before the first frame, s."""
    seconds: float | None = None
    """Duration, s; without end unless given."""


def feed_of(args: PublishArgs) -> Feed:
    """Return the frames that are published; nothing is left to compile at the first one."""
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.config import load_config
    from spikingtac.pipeline.checked_source import refuse
    from spikingtac.ros2.feed import feed_of_events, feed_of_tracks
    from spikingtac.ros2.stream import rehearse
    from spikingtac.stream.sources import open_live
    from spikingtac.touch.force.model import load_force
    from spikingtac.tracks import Tracks, is_tracks_file

    calibration = None if args.calibration is None else Calibration.load(args.calibration)
    force = None if args.force is None else load_force(args.force)
    if args.source.is_file() and is_tracks_file(args.source):
        feed = feed_of_tracks(Tracks.load(args.source), calibration, force)
    elif calibration is None:
        raise ConfigError(
            "events need the sensor's calibration: --calibration calibration.json; "
            "make one with: spikingtac calibrate RECORDING -o calibration.json"
        )
    else:
        tracking = load_config(args.preset).with_tracking(rate_hz=args.rate_hz).tracking
        events = open_live(args.source, strict=args.strict, sensor=args.sensor)
        tell = refuse if args.strict else warn
        feed = feed_of_events(events, calibration, tracking, force, tell)
    rehearse(feed.layout)
    return feed


def publish(args: PublishArgs, feed: Feed, publisher: Publisher, **config: Any) -> int:
    """Publish until the source ends, --seconds of it are over, or Ctrl-C; tell the figures.

    Args:
        args: The verb's options.
        feed: The frames.
        publisher: Sends the messages.
        **config: Further settings of :class:`spikingtac.ros2.stream.StreamConfig`.
    """
    from spikingtac.ros2.feed import Pace
    from spikingtac.ros2.stream import SensorStream, StreamConfig
    from spikingtac.stream.real_time import exempt_from_collection

    own = {"hardware": args.source.name, "wrench": feed.has_wrench}
    own["events"] = feed.source is not None and not args.without_events
    shown = StreamConfig(**own, **config)
    stream = SensorStream(publisher, feed.layout, shown)
    exempt_from_collection()  # a collection in the middle would hold up 200 frames
    pace, stop, begun_s = Pace(), _Stop(), time.monotonic()
    try:
        wait_for_reader(publisher, f"{shown.prefix}/field", args.wait_s)
        with ending_on_interrupt(feed.source, stop):
            _publish(feed, stream, pace, args.seconds, stop)
    except KeyboardInterrupt:
        stop.close()
    if stop.asked:
        remark("ended")
    time.sleep(ENDING_S)
    found = {
        "seconds": round(time.monotonic() - begun_s, 3),
        "largest_lag_ms": round(1e3 * pace.largest_lag_s, 3),
        "messages": dict(sorted(stream.counts.items())),
        "anomalies": anomalies(feed),
    }
    sent = ", ".join(f"{count} {name}" for name, count in found["messages"].items())
    behind = f"at most {found['largest_lag_ms']:.0f} ms behind"
    return tell(args.json, found, f"published {sent}; {behind}")


def wait_for_reader(publisher: Publisher, topic: str, wait_s: float) -> None:
    """Wait until somebody reads a topic, but not longer than ``wait_s``."""
    deadline_s = time.monotonic() + wait_s
    while not publisher.readers(topic) and time.monotonic() < deadline_s:
        time.sleep(LOOK_S)


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
        first_us = frame.t_us if first_us is None else first_us
        if stop.asked:
            return
        if seconds is not None and frame.t_us - first_us >= seconds * 1e6:
            return
