"""A Foxglove server: the topics of ROS 2 over a web socket, for users of the app without ROS.

Messages are those of :mod:`spikingtac.ros2.dds`, byte by byte, with ROS 2's definitions as schemas.
Clients read; they change nothing. The protocol is Foxglove's web socket protocol, version 1
(https://github.com/foxglove/ws-protocol). Foxglove's own library cannot refuse a connection by its
Origin or Host, so that any page in the user's browser could read a server of it.
"""

from __future__ import annotations

import asyncio
import json
import logging
import struct
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from socket import socket
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from spikingtac.ros2.messages import definition, encode, ros_type

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

_LOG = logging.getLogger(__name__)
_LOG.disabled = True  # what a foreign client does wrong is nothing to the user

# Names of the protocol's version 1, the newer one first.
PROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
MESSAGE_DATA = 1  # Operation code of a message (ws-protocol.md).

# Bytes that wait for a slow client: 4 s of a display. It gets no further ones until it has read.
BACKLOG_BYTES = 1 << 20
PATIENCE_S = 1.0  # Time for a client to take what waits for it when the server ends, s.

# Returns why a request is refused, from its headers and token; an empty text lets it in.
Refusal = Callable[[Mapping[str, str], str | None], str]


class FoxglovePublisher:
    """Serves messages to the clients that subscribe, without waiting for slow ones.

    It is a :class:`~spikingtac.ros2.messages.Publisher`; the server runs in a thread of its own.

    Args:
        listening: A bound socket, as of :func:`spikingtac.viewer.access.listen`.
        refusal: Decides about each connection.
        allowed: Web pages that may connect, by their Origin, besides those that are let in anyway.

    Attributes:
        port: On which it listens.
    """

    def __init__(self, listening: socket, refusal: Refusal, allowed: Sequence[str] = ()) -> None:
        self.port: int = listening.getsockname()[1]
        self._refusal, self._allowed = refusal, allowed
        self._channels: dict[str, dict[str, Any]] = {}
        self._messages: dict[str, str] = {}
        self._states: dict[int, bytes | None] = {}  # channel -> its last message
        # Client -> number of a subscription -> its channel.
        self._clients: dict[ServerConnection, dict[int, int]] = {}
        begun = threading.Event()
        work = partial(asyncio.run, self._serve(listening, begun))
        self._thread = threading.Thread(target=work, name="foxglove", daemon=True)
        self._thread.start()
        begun.wait()

    def advertise(self, topic: str, message: str, *, state: bool = False) -> None:
        """Announce a topic."""
        channel = {
            "id": len(self._channels) + 1,
            "topic": topic,
            "encoding": "cdr",
            "schemaName": ros_type(message),
            "schemaEncoding": "ros2msg",
            "schema": definition(message),
        }
        self._messages[topic], self._channels[topic] = message, channel
        if state:
            self._states[channel["id"]] = None
        self._loop.call_soon_threadsafe(self._announce, channel)

    def publish(self, topic: str, values: Mapping[str, Any], t_ns: int) -> None:
        """Send a message; without a subscriber it is not even encoded."""
        channel = self._channels[topic]["id"]
        if channel not in self._states and not self.readers(topic):
            return
        encoded = encode(self._messages[topic], values)
        if channel in self._states:
            self._states[channel] = encoded
        self._loop.call_soon_threadsafe(self._send, channel, encoded)

    def readers(self, topic: str) -> int:
        """Return how many subscriptions a topic has now."""
        channel = self._channels[topic]["id"]
        return sum(list(one.values()).count(channel) for one in list(self._clients.values()))

    def close(self) -> None:
        """Let all clients go, after a moment for what waits for them."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._ended.set)
            self._thread.join()

    async def _serve(self, listening: socket, begun: threading.Event) -> None:
        from websockets.asyncio.server import serve

        self._loop, self._ended = asyncio.get_running_loop(), asyncio.Event()
        async with serve(
            self._attend,
            sock=listening,
            subprotocols=PROTOCOLS,  # pyright: ignore[reportArgumentType]
            process_request=self._refuse,
            compression=None,
            close_timeout=PATIENCE_S,
            logger=_LOG,
        ):
            begun.set()
            await self._ended.wait()
            self._loop.call_later(PATIENCE_S, self._abandon)

    def _abandon(self) -> None:
        for client in self._clients:  # they do not read: nothing can be told to them
            client.transport.abort()

    def _announce(self, channel: dict[str, Any]) -> None:
        for client in self._clients:
            self._tell(client, {"op": "advertise", "channels": [channel]})

    def _refuse(self, connection: ServerConnection, request: Request) -> Response | None:
        headers = {name.lower(): value for name, value in request.headers.raw_items()}
        if headers.get("origin") in self._allowed:
            del headers["origin"]
        token = parse_qs(urlsplit(request.path).query).get("token", [None])[0]
        why = self._refusal(headers, token)
        return connection.respond(HTTPStatus.FORBIDDEN, f"{why}\n") if why else None

    async def _attend(self, client: ServerConnection) -> None:
        """Serve one client until it leaves."""
        self._tell(client, {"op": "serverInfo", "name": "spikingtac", "capabilities": []})
        self._tell(client, {"op": "advertise", "channels": list(self._channels.values())})
        wanted = self._clients[client] = {}
        try:
            async for text in client:
                # What is not in this form is ignored.
                with suppress(ValueError, TypeError, KeyError, struct.error):
                    self._answer(client, wanted, json.loads(text))
        finally:
            del self._clients[client]

    def _answer(
        self, client: ServerConnection, wanted: dict[int, int], asked: dict[str, Any]
    ) -> None:
        """Do what a client asks for, where it may."""
        if asked["op"] == "subscribe":
            for one in asked["subscriptions"]:
                subscription, channel = one["id"], one["channelId"]
                _message(subscription, b"")  # struct.error for a number that no message can carry
                wanted[subscription] = channel
                kept = self._states.get(channel)
                if kept is not None:
                    self._tell(client, _message(subscription, kept))
        elif asked["op"] == "unsubscribe":
            for subscription in asked["subscriptionIds"]:
                wanted.pop(int(subscription), None)

    def _send(self, channel: int, encoded: bytes) -> None:
        for client, wanted in self._clients.items():
            for subscription, chosen in wanted.items():
                if chosen == channel:
                    self._tell(client, _message(subscription, encoded))

    @staticmethod
    def _tell(client: ServerConnection, told: bytes | dict[str, Any]) -> None:
        from websockets.asyncio.server import broadcast  # it waits for nobody

        if client.transport.get_write_buffer_size() < BACKLOG_BYTES:
            broadcast([client], json.dumps(told) if isinstance(told, dict) else told)


def _message(subscription: int, encoded: bytes) -> bytes:
    return struct.pack("<BIQ", MESSAGE_DATA, subscription, time.time_ns()) + encoded
