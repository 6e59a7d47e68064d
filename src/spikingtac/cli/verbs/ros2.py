"""``spikingtac ros2`` and ``foxglove``: publish a sensor, live; ROS need not be installed."""

from __future__ import annotations

import threading
import time
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any

import tyro

import spikingtac as st
from spikingtac.cli.messages import remark, tell, warn
from spikingtac.cli.options import OF_EVENTS, ReadArgs, TrackerArgs
from spikingtac.cli.sources import anomalies_of, ending_on_interrupt
from spikingtac.file_kinds import kind_of

if TYPE_CHECKING:
    from spikingtac.ros2.feed import Feed
    from spikingtac.ros2.messages import Publisher

LOOK_S = 0.01  # Time between two looks for a reader, s.
ENDING_S = 0.1  # Time for the last messages to leave before the topics end, s.

# Origins of the Foxglove app in a browser.
FOXGLOVE_ORIGINS = ("https://app.foxglove.dev", "https://studio.foxglove.dev")


@dataclass(frozen=True, kw_only=True)
class PublishArgs(TrackerArgs, ReadArgs):
    """Options of verbs that publish a sensor.

    Attributes:
        source: A camera's address, event file or recording folder, with --calibration; or
            tracks.npz.
        force: Force model: publish the wrench, too; make one with: spikingtac force fit.
        wait_s: Longest wait for a first reader of the field before the first frame, s.
        seconds: Duration, s; without end unless given.
    """

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SOURCE")]
    force: Path | None = None
    wait_s: float = 0.0
    seconds: float | None = None


@dataclass(frozen=True, kw_only=True)
class Args(PublishArgs):
    """Publish displacement field, arrows, wrench, contact, events, diagnostics to ROS 2, over DDS.

    Cameras are published as they send, recordings and tracks at the speed of their recording.
    Nothing leaves this machine unless --interface says so.

    Attributes:
        prefix: Begins the name of every topic: /tactile/field, ...
        domain: ROS_DOMAIN_ID.
        interface: Network interface to publish on; lo is this machine alone.
        reliable: Resend what readers missed, instead of the best effort that is usual for sensors.
    """

    prefix: str = "/tactile"
    domain: int = 0
    interface: str = "lo"
    reliable: bool = False


def run(args: Args) -> int:
    """Publish until the source ends, or until Ctrl-C."""
    from spikingtac.ros2.dds import DdsPublisher

    feed = feed_of(args)
    with closing(DdsPublisher(args.domain, args.interface, args.reliable)) as publisher:
        where = "this machine" if args.interface == "lo" else args.interface
        told = f"publishing {args.prefix}/field and more on {where}, domain {args.domain}"
        return publish(args, feed, publisher, told, prefix=args.prefix)


@dataclass(frozen=True, kw_only=True)
class FoxgloveArgs(PublishArgs):
    """Serve displacement field, arrows, wrench, contact, events, diagnostics to Foxglove.

    Cameras are shown as they send, recordings and tracks at the speed of their recording. The
    server listens on this machine alone unless --host says otherwise.

    Attributes:
        field_hz: Fields and wrenches that are shown per second, at most every frame.
        host: Address to serve on. Beyond this machine a random token is needed, which is printed.
        port: Port, or 0 for any free one.
        allow_origin: Web pages that may connect, by their Origin; those of the Foxglove app unless
            given.
    """

    field_hz: float = 100.0
    host: str = "127.0.0.1"
    port: int = 8766
    allow_origin: tuple[str, ...] = FOXGLOVE_ORIGINS


def foxglove(args: FoxgloveArgs) -> int:
    """Serve until the source ends, or until Ctrl-C."""
    from spikingtac.ros2.foxglove import FoxglovePublisher
    from spikingtac.viewer.access import Gate, listen

    feed = feed_of(args)
    gate, listening = Gate.for_host(args.host), listen(args.host, args.port)
    with closing(FoxglovePublisher(listening, gate.refusal, args.allow_origin)) as publisher:
        token = f"/?token={gate.token}" if gate.token else ""
        address = f"ws://{args.host}:{publisher.port}{token}"
        told = f"open {address} in Foxglove (Open connection)"
        return publish(args, feed, publisher, told, field_hz=args.field_hz)


def feed_of(args: PublishArgs) -> Feed:
    """Return the frames that are published; nothing is left to compile at the first one."""
    from spikingtac.pipeline.follow import refuse
    from spikingtac.ros2.feed import feed_of_events, feed_of_tracks, rehearse
    from spikingtac.stream.reader import open_live

    calibration = None if args.calibration is None else st.Calibration.load(args.calibration)
    force = None if args.force is None else st.load_force(args.force)
    if kind_of(args.source) == "tracks":
        args.refuse(f"is for events, and {args.source.name} is tracks", *OF_EVENTS)
        feed = feed_of_tracks(st.Tracks.load(args.source), calibration, force)
    else:
        events = open_live(args.source, strict=args.strict, sensor=args.sensor)
        calibration = calibration or st.Calibration.load(args.needed_calibration())
        tracking = st.load_config(args.preset).with_tracking(rate_hz=args.rate_hz).tracking
        told = refuse if args.strict else warn
        feed = feed_of_events(events, calibration, tracking, force, told)
    rehearse(feed.sensor)
    return feed


def publish(args: PublishArgs, feed: Feed, publisher: Publisher, told: str, **settings: Any) -> int:
    """Publish until the source ends, --seconds of it are over, or Ctrl-C; tell the figures.

    Args:
        args: The verb's options.
        feed: The frames.
        publisher: Sends the messages.
        told: Where they are found.
        **settings: Further arguments of :class:`spikingtac.ros2.stream.SensorStream`.
    """
    from spikingtac.ros2.stream import SensorStream
    from spikingtac.stream.reader import no_longer_than
    from spikingtac.stream.real_time import exempt_from_collection

    anomalies = partial(anomalies_of, *([] if feed.source is None else [feed.source]))
    stream = SensorStream(publisher, replace(feed.sensor, name=args.source.name), **settings)
    remark(f"{told}; Ctrl-C ends")
    exempt_from_collection()  # a collection in the middle would hold up 200 frames
    stop, begun_s = threading.Event(), time.monotonic()
    first_us: int | None = None
    # Tracks and recordings cannot be closed, and an interrupt in the middle of a message would end
    # the process by the signal: publishing ends at the next frame.
    with ending_on_interrupt(feed.source, SimpleNamespace(close=stop.set)):
        while time.monotonic() < begun_s + args.wait_s and not stop.is_set():
            if publisher.readers(stream.topics["field"]):
                break
            time.sleep(LOOK_S)
        with no_longer_than(feed.source, args.seconds):
            for frame, wrench in feed.frames(stream):
                feed.pace.behind_ms()
                stream.frame(frame, wrench, anomalies())
                first_us = frame.t_us if first_us is None else first_us
                over = args.seconds is not None and frame.t_us - first_us >= args.seconds * 1e6
                if stop.is_set() or over:
                    break
    if stop.is_set():
        remark("ended")
    time.sleep(ENDING_S)
    found = {
        "seconds": round(time.monotonic() - begun_s, 3),
        "largest_lag_ms": round(feed.pace.most_ms, 3),
        "messages": dict(sorted(stream.counts.items())),
        "anomalies": anomalies(),
    }
    sent = ", ".join(f"{count} {name}" for name, count in found["messages"].items()) or "nothing"
    return tell(args.json, found, f"published {sent}; at most {feed.pace.most_ms:.0f} ms behind")
