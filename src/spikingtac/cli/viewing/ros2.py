"""``spikingtac ros2``: publish a sensor to ROS 2, live; ROS need not be installed."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from spikingtac.cli.messages import remark, warn
from spikingtac.cli.viewing.publishing import publish_until, tell, wait_for_reader

if TYPE_CHECKING:
    from spikingtac.ros2.dds import DdsPublisher
    from spikingtac.ros2.feed import Feed
    from spikingtac.ros2.stream import SensorStream


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
    """Resend what readers missed, instead of the best effort that is usual for sensors."""
    without_events: bool = False
    """Do not publish the events."""
    distance_mm: float | None = None
    """Distance from the lens to the skin, mm: gives the camera info a focal length, with the scale
    of the calibration."""
    wait_s: float = 0.0
    """Longest wait for a first reader of the field before the first frame, s."""
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
    """Publish until the source ends, or until Ctrl-C."""
    from spikingtac.ros2.dds import DdsConfig, DdsPublisher, dds_topic
    from spikingtac.ros2.feed import FeedConfig, open_feed
    from spikingtac.ros2.stream import rehearse

    field = f"{args.prefix}/field"
    dds_topic(field)  # refuses a prefix that is none
    config = DdsConfig(domain=args.domain, interface=args.interface, reliable=args.reliable)
    names = ("source", "calibration", "preset", "rate_hz", "force", "sensor", "strict")
    given = {name: getattr(args, name) for name in names}
    feed = open_feed(FeedConfig(**given, tell=warn))
    _check_distance(args, feed)
    rehearse(feed.layout)
    with closing(DdsPublisher(config)) as publisher:
        stream = _announce(args, feed, publisher)
        where = "this machine" if args.interface == "lo" else args.interface
        remark(f"publishing {field} and more on {where}, domain {args.domain}; Ctrl-C ends")
        ready = partial(wait_for_reader, publisher, field, args.wait_s)
        found = publish_until(feed, stream, args.seconds, ready)
    tell(found, as_json=args.json)
    return 0


def _check_distance(args: Args, feed: Feed) -> None:
    from spikingtac.ros2.messages import camera_info_message

    if args.distance_mm is not None:
        camera_info_message(feed.layout, args.distance_mm)  # refuses it where it says nothing


def _announce(args: Args, feed: Feed, publisher: DdsPublisher) -> SensorStream:
    from spikingtac.ros2.stream import SensorStream, StreamConfig

    config = StreamConfig(
        prefix=args.prefix,
        hardware=args.source.name,
        events=feed.source is not None and not args.without_events,
        wrench=feed.has_wrench,
        distance_mm=args.distance_mm,
    )
    return SensorStream(publisher, feed.layout, config, feed.force)
