"""``spikingtac ros2``: publish a sensor to ROS 2, live; ROS need not be installed."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from spikingtac.cli.interrupt import ending_on_interrupt
from spikingtac.cli.messages import emit_json, remark, warn

if TYPE_CHECKING:
    from spikingtac.ros2.dds import DdsPublisher
    from spikingtac.ros2.feeds import Feed
    from spikingtac.ros2.service import TriggerService
    from spikingtac.ros2.stream import Pace, SensorStream

ENDING_S = 0.1
"""Time for the last messages to leave before the topics end, s."""
SERVE_US = 20_000
"""Time between two looks for requests, us."""
LOOK_S = 0.01
"""Time between two looks for a reader, s."""


@dataclass(frozen=True, kw_only=True)
class Args:
    """Publish displacement field, arrows, wrench, contact, events, diagnostics to ROS 2, over DDS.

    Cameras are published as they send, recordings and tracks at the speed of their recording.
    Nothing leaves this machine unless --interface says so.
    """

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SOURCE")]
    """A camera's address, event file or recording folder, with --calibration; or tracks.npz."""
    calibration: Path | None = None
    """calibration.json of this sensor; make one with: spikingtac calibrate."""
    preset: str = "default"
    """Tracker: default, fast or paper, or a TOML file."""
    rate_hz: float | None = None
    """Frames per second; the preset's unless given."""
    force: Path | None = None
    """force.json: publish the wrench, too; make one with: spikingtac force fit."""
    prefix: str = "/tactile"
    """Begins the name of every topic: /tactile/field, ..."""
    domain: int = 0
    """ROS_DOMAIN_ID."""
    interface: str = "lo"
    """Network interface to publish on; lo is this machine alone."""
    reliable: bool = False
    """Send again what readers missed, instead of best effort as sensors do."""
    without_events: bool = False
    """Do not publish the events."""
    wait_s: float = 0.0
    """Wait so long for a first reader of the field before the first frame."""
    seconds: float | None = None
    """End after so many seconds."""
    sensor: int = 0
    """In a folder, the sensor to read: 1 reads events_1.raw."""
    strict: bool = False
    """Refuse a damaged recording instead of repairing it, and the calibration of another sensor
    instead of a warning."""
    json: bool = False
    """Print one JSON object at the end."""


def run(args: Args) -> int:
    """Publish until the source ends, or until Ctrl-C."""
    from spikingtac.ros2.dds import DdsConfig, DdsPublisher, dds_topic
    from spikingtac.ros2.feeds import FeedConfig, open_feed
    from spikingtac.ros2.service import TriggerService
    from spikingtac.ros2.stream import Pace

    dds_topic(f"{args.prefix}/field")  # refuses a prefix that is none
    config = DdsConfig(domain=args.domain, interface=args.interface, reliable=args.reliable)
    names = ("source", "calibration", "preset", "rate_hz", "force", "sensor", "strict")
    given = {name: getattr(args, name) for name in names}
    feed = open_feed(FeedConfig(**given, tell=warn))
    publisher, pace = DdsPublisher(config), Pace()
    stream = _announce(args, feed, publisher)
    reset = TriggerService(publisher, f"{args.prefix}/reset", _resetting(feed))
    where = "this machine" if args.interface == "lo" else args.interface
    remark(f"publishing {args.prefix}/field and more on {where}, domain {args.domain}; Ctrl-C ends")
    begun_s = time.monotonic()
    stop = _Stop()
    try:
        _wait(args, publisher)
        with ending_on_interrupt(feed.source, stop):
            _publish(feed, stream, pace, (args.seconds, stop), reset)
    except KeyboardInterrupt:
        stop.close()
    if stop.asked:
        remark("ended")
    time.sleep(ENDING_S)
    publisher.close()
    found = {
        "seconds": round(time.monotonic() - begun_s, 3),
        "largest_lag_ms": round(1e3 * pace.largest_lag_s, 3),
        "messages": dict(sorted(stream.counts.items())),
        "anomalies": _anomalies(feed),
    }
    if args.json:
        emit_json(found)
    else:
        told = ", ".join(f"{count} {name}" for name, count in found["messages"].items())
        remark(f"published {told}; at most {found['largest_lag_ms']:.0f} ms behind")
    return 0


def _announce(args: Args, feed: Feed, publisher: DdsPublisher) -> SensorStream:
    from spikingtac.ros2.stream import SensorStream, StreamConfig

    config = StreamConfig(
        prefix=args.prefix,
        hardware=args.source.name,
        events=feed.source is not None and not args.without_events,
        wrench=feed.has_wrench,
    )
    return SensorStream(publisher, feed.layout, config, feed.force)


def _wait(args: Args, publisher: DdsPublisher) -> None:
    deadline_s = time.monotonic() + args.wait_s
    while not publisher.readers(f"{args.prefix}/field") and time.monotonic() < deadline_s:
        time.sleep(LOOK_S)


class _Stop:
    """Ends the publishing of what cannot be closed, tracks and recordings, at the next frame.

    An interrupt in the middle of a message would end the process by the signal, not with 0.
    """

    asked = False

    def close(self) -> None:
        self.asked = True


def _publish(
    feed: Feed,
    stream: SensorStream,
    pace: Pace,
    until: tuple[float | None, _Stop],
    reset: TriggerService,
) -> None:
    seconds, stop = until
    first_us: int | None = None
    served_us = 0
    for frame, wrench in feed.frames(stream, pace):
        stream.frame(frame, wrench, _anomalies(feed))
        first_us = frame.t_us if first_us is None else first_us
        if frame.t_us - served_us >= SERVE_US:
            served_us = frame.t_us
            reset.serve()
        if stop.asked:
            return
        if seconds is not None and frame.t_us - first_us >= seconds * 1e6:
            return


def _resetting(feed: Feed) -> Callable[[], tuple[bool, str]]:
    def answer() -> tuple[bool, str]:
        done = feed.reset()
        return done, "the markers rest" if done else "tracks are published, there is no tracker"

    return answer


def _anomalies(feed: Feed) -> dict[str, int]:
    return {} if feed.source is None else dict(feed.source.losses.kinds())
