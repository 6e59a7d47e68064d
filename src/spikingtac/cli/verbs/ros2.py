"""``spikingtac ros2``: publish a sensor to ROS 2, live; ROS need not be installed."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass

from spikingtac.cli.messages import remark
from spikingtac.cli.publishing import PublishArgs, feed_of, publish


@dataclass(frozen=True, kw_only=True)
class Args(PublishArgs):
    """Publish displacement field, arrows, wrench, contact, events, diagnostics to ROS 2, over DDS.

    Cameras are published as they send, recordings and tracks at the speed of their recording.
    Nothing leaves this machine unless --interface says so.
    """

    prefix: str = "/tactile"
    """Begins the name of every topic: /tactile/field, ..."""
    domain: int = 0
    """ROS_DOMAIN_ID."""
    interface: str = "lo"
    """Network interface to publish on; lo is this machine alone."""
    reliable: bool = False
    """Resend what readers missed, instead of the best effort that is usual for sensors."""
    distance_mm: float | None = None
    """Distance from the lens to the skin, mm: gives the camera info a focal length, with the scale
    of the calibration."""


def run(args: Args) -> int:
    """Publish until the source ends, or until Ctrl-C."""
    from spikingtac.ros2.dds import DdsConfig, DdsPublisher

    config = DdsConfig(domain=args.domain, interface=args.interface, reliable=args.reliable)
    feed = feed_of(args)
    with closing(DdsPublisher(config)) as publisher:
        where = "this machine" if args.interface == "lo" else args.interface
        remark(
            f"publishing {args.prefix}/field and more on {where}, domain {args.domain}; Ctrl-C ends"
        )
        return publish(args, feed, publisher, prefix=args.prefix, distance_mm=args.distance_mm)
