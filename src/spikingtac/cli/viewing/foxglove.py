"""``spikingtac foxglove``: show a sensor in Foxglove, live; neither ROS nor a bridge is needed."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from spikingtac.cli.messages import remark, warn
from spikingtac.cli.viewing.publishing import publish_until, tell, wait_for_reader
from spikingtac.errors import ConfigError

FIELD = "/tactile/field"


@dataclass(frozen=True, kw_only=True)
class Args:
    """Serve displacement field, arrows, wrench, contact, events, diagnostics to Foxglove.

    Cameras are shown as they send, recordings and tracks at the speed of their recording. The
    server listens on this machine alone unless --host says otherwise.
    """

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SOURCE")]
    """A camera's address, event file or recording folder, with --calibration; or tracks.npz."""
    calibration: Path | None = None
    """calibration.json of this sensor; make one with: spikingtac calibrate."""
    preset: str = "default"
    """Tracker: default, fast or paper, or a TOML file."""
    rate_hz: float | None = None
    """Frames per second; the preset's unless given."""
    field_hz: float = 100.0
    """Fields and wrenches that are shown per second, at most every frame."""
    force: Path | None = None
    """force.json: show the wrench, too; make one with: spikingtac force fit."""
    host: str = "127.0.0.1"
    """Address to serve on. Whoever reaches it sees everything: there is no password."""
    port: int = 8766
    """Port, or 0 for any free one."""
    without_events: bool = False
    """Do not serve the events."""
    wait_s: float = 0.0
    """Longest wait for a first subscriber of the field before the first frame, s."""
    seconds: float | None = None
    """Duration, s; without end unless given."""
    sensor: int = 0
    """In a folder, the sensor to read: 1 reads events_1.raw."""
    strict: bool = False
    """Refuse a damaged recording instead of repairing it, and the calibration of another sensor
    instead of a warning."""
    json: bool = False
    """Print one JSON object at the end."""


def run(args: Args) -> int:
    """Serve until the source ends, or until Ctrl-C."""
    from spikingtac.ros2.feeds import FeedConfig, open_feed
    from spikingtac.ros2.foxglove_server import FoxgloveConfig, FoxglovePublisher
    from spikingtac.ros2.stream import SensorStream, StreamConfig, rehearse

    config = FoxgloveConfig(host=args.host, port=args.port)
    names = ("source", "calibration", "preset", "rate_hz", "force", "sensor", "strict")
    given = {name: getattr(args, name) for name in names}
    feed = open_feed(FeedConfig(**given, tell=warn))
    try:
        feed.settings.set({"publish.field_hz": args.field_hz})
    except ConfigError as error:
        raise ConfigError(f"--field-hz: {error}") from error
    rehearse(feed.layout)
    with closing(FoxglovePublisher(config, feed.settings)) as publisher:
        shown = StreamConfig(
            hardware=args.source.name,
            events=feed.source is not None and not args.without_events,
            wrench=feed.has_wrench,
        )
        stream = SensorStream(publisher, feed.layout, shown, feed.force, feed.settings.config)
        feed.settings.watch(stream.retune)
        remark(f"open ws://{args.host}:{publisher.port} in Foxglove (Open connection); Ctrl-C ends")
        ready = partial(wait_for_reader, publisher, FIELD, args.wait_s)
        found = publish_until(feed, stream, args.seconds, ready)
    tell(found, as_json=args.json)
    return 0
