"""``spikingtac foxglove``: show a sensor in Foxglove, live; neither ROS nor a bridge is needed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import partial

from spikingtac.cli.messages import remark
from spikingtac.cli.verbs.ros2 import PublishArgs, feed_of, publish

# Origins of the Foxglove app in a browser.
FOXGLOVE_ORIGINS = ("https://app.foxglove.dev", "https://studio.foxglove.dev")


@dataclass(frozen=True, kw_only=True)
class Args(PublishArgs):
    """Serve displacement field, arrows, wrench, contact, events, diagnostics to Foxglove.

    Cameras are shown as they send, recordings and tracks at the speed of their recording. The
    server listens on this machine alone unless --host says otherwise.
    """

    field_hz: float = 100.0
    """Fields and wrenches that are shown per second, at most every frame."""
    host: str = "127.0.0.1"
    """Address to serve on. Beyond this machine a random token is needed, which is printed."""
    port: int = 8766
    """Port, or 0 for any free one."""
    allow_origin: tuple[str, ...] = FOXGLOVE_ORIGINS
    """Web pages that may connect, by their Origin; those of the Foxglove app unless given."""


def run(args: Args) -> int:
    """Serve until the source ends, or until Ctrl-C."""
    from spikingtac.ros2.foxglove import FoxglovePublisher
    from spikingtac.viewer.access import Gate

    feed = feed_of(args)
    gate = Gate.for_host(args.host)
    refusal = partial(_refusal, gate.refusal, args.allow_origin)
    with closing(FoxglovePublisher(args.host, args.port, refusal)) as publisher:
        token = f"/?token={gate.token}" if gate.token else ""
        address = f"ws://{args.host}:{publisher.port}{token}"
        remark(f"open {address} in Foxglove (Open connection); Ctrl-C ends")
        return publish(args, feed, publisher, field_hz=args.field_hz)


def _refusal(
    refusal: Callable[[Mapping[str, str], str | None], str],
    allowed: tuple[str, ...],
    headers: Mapping[str, str],
    token: str | None,
) -> str:
    """Return why a connection is refused; the allowed pages pass as if they were our own."""
    known = headers.get("origin") in allowed
    return refusal({k: v for k, v in headers.items() if not (known and k == "origin")}, token)
