"""A Foxglove server: the topics of ROS 2 over a web socket, for users of the app without ROS.

Messages are those of :mod:`spikingtac.ros2.dds`, byte by byte, with ROS 2's definitions as schemas.
Clients read; they change nothing. The protocol is Foxglove's web socket protocol, version 1
(https://github.com/foxglove/ws-protocol). Foxglove's own library cannot refuse a connection by its
Origin or Host, so that any page in the user's browser could read a server of it.
"""

from __future__ import annotations

import ipaddress
import json
import struct
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from http import HTTPStatus
from queue import Empty, Full, Queue
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from spikingtac.errors import ConfigError, DeviceError
from spikingtac.ros2.messages import definition, encode, ros_type

if TYPE_CHECKING:
    from websockets.http11 import Request, Response
    from websockets.sync.server import ServerConnection

# Names of the protocol's version 1, the newer one first.
PROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
MESSAGE_DATA = 1  # Operation code of a message (ws-protocol.md).

# Messages that wait for a slow client: 4 s of a display. The oldest are dropped then.
BACKLOG = 256
LARGEST_PORT = 65_535
PATIENCE_S = 1.0  # Time for a client to take what waits for it when the server ends, s.

# Returns why a request is refused, from its headers and token; an empty text lets it in.
Refusal = Callable[[Mapping[str, str], str | None], str]


class FoxglovePublisher:
    """Serves messages to the clients that subscribe, without waiting for slow ones.

    It is a :class:`~spikingtac.ros2.stream.Publisher`.

    Args:
        host: Address of an interface of this machine; loopback is this machine alone.
        port: Port, or 0 for any free one.
        refusal: Decides about each connection.

    Attributes:
        port: On which it listens.

    Raises:
        ConfigError: Host or port are not valid.
        DeviceError: The port is taken, or the address is none of this machine.
    """

    def __init__(self, host: str, port: int, refusal: Refusal) -> None:
        from websockets.sync.server import serve

        if not 0 <= port <= LARGEST_PORT:
            raise ConfigError(f"the port is {port}, it must be 0 to {LARGEST_PORT}")
        try:
            ipaddress.ip_address(host)
        except ValueError as error:
            raise ConfigError(
                f"{host!r} is no address; valid are those of this machine, as 127.0.0.1"
            ) from error
        self._refusal, self._lock = refusal, threading.Lock()
        self._channels: dict[str, dict[str, Any]] = {}
        self._messages: dict[str, str] = {}
        self._states: dict[int, bytes | None] = {}  # channel -> its last message
        self._clients: list[_Client] = []
        try:
            self._server = serve(
                self._attend,
                host,
                port,
                subprotocols=PROTOCOLS,  # pyright: ignore[reportArgumentType]
                process_request=self._refuse,
                compression=None,
                close_timeout=PATIENCE_S,
            )
        except OSError as error:
            raise DeviceError(
                f"Foxglove cannot be served on {host}:{port}: {error}; another --port may be free "
                "(0 takes any)"
            ) from error
        self.port: int = self._server.socket.getsockname()[1]
        threading.Thread(target=self._server.serve_forever, name="foxglove", daemon=True).start()

    def advertise(self, topic: str, message: str, *, state: bool = False) -> None:
        """Announce a topic."""
        with self._lock:
            channel = {
                "id": len(self._channels) + 1,
                "topic": topic,
                "encoding": "cdr",
                "schemaName": ros_type(message),
                "schemaEncoding": "ros2msg",
                "schema": definition(message),
            }
            self._channels[topic], self._messages[topic] = channel, message
            if state:
                self._states[channel["id"]] = None
            for client in self._clients:
                client.put(json.dumps({"op": "advertise", "channels": [channel]}))

    def publish(self, topic: str, values: Mapping[str, Any], t_ns: int) -> None:
        """Send a message; without a subscriber it is not even encoded."""
        channel = self._channels[topic]["id"]
        with self._lock:
            wanted = [(client, one) for client in self._clients for one in client.wanting(channel)]
        if not wanted and channel not in self._states:
            return
        encoded = encode(self._messages[topic], values)
        if channel in self._states:
            self._states[channel] = encoded
        for client, subscription in wanted:
            client.put_message(subscription, encoded)

    def readers(self, topic: str) -> int:
        """Return how many subscriptions a topic has now."""
        channel = self._channels[topic]["id"]
        with self._lock:
            return sum(len(client.wanting(channel)) for client in self._clients)

    def close(self) -> None:
        """Let all clients go, after a moment for what waits for them."""
        self._server.shutdown()
        with self._lock:
            clients = list(self._clients)
        for client in clients:
            client.end()

    def _refuse(self, connection: ServerConnection, request: Request) -> Response | None:
        headers = {name.lower(): value for name, value in request.headers.raw_items()}
        token = parse_qs(urlsplit(request.path).query).get("token", [None])[0]
        why = self._refusal(headers, token)
        return connection.respond(HTTPStatus.FORBIDDEN, f"{why}\n") if why else None

    def _attend(self, connection: ServerConnection) -> None:
        """Serve one client until it leaves; runs in a thread of its own."""
        client = _Client(connection)
        with self._lock:
            client.put(json.dumps({"op": "serverInfo", "name": "spikingtac", "capabilities": []}))
            channels = list(self._channels.values())
            client.put(json.dumps({"op": "advertise", "channels": channels}))
            self._clients.append(client)
        try:
            for text in connection:
                with suppress(ValueError, TypeError, KeyError):  # not in this form: ignored
                    self._answer(client, json.loads(text))
        finally:
            with self._lock:
                self._clients.remove(client)
            client.end()

    def _answer(self, client: _Client, asked: dict[str, Any]) -> None:
        """Do what a client asks for, where it may."""
        if asked["op"] == "subscribe":
            for one in asked["subscriptions"]:
                subscription, channel = int(one["id"]), int(one["channelId"])
                client.wanted[subscription] = channel
                kept = self._states.get(channel)
                if kept is not None:
                    client.put_message(subscription, kept)
        elif asked["op"] == "unsubscribe":
            for subscription in asked["subscriptionIds"]:
                client.wanted.pop(int(subscription), None)


class _Client:
    """A connection with a bounded queue, emptied by a thread of its own.

    Attributes:
        wanted: Number of a subscription -> id of its channel.
    """

    def __init__(self, connection: ServerConnection) -> None:
        self._connection = connection
        self.wanted: dict[int, int] = {}
        self._waiting: Queue[str | bytes | None] = Queue(BACKLOG)
        self._thread = threading.Thread(target=self._send, name="foxglove client", daemon=True)
        self._thread.start()

    def wanting(self, channel: int) -> list[int]:
        return [one for one, wanted in list(self.wanted.items()) if wanted == channel]

    def put(self, data: str | bytes | None) -> None:
        """Add a message; where too many wait, the oldest go."""
        while True:
            try:
                self._waiting.put_nowait(data)
                return
            except Full:
                with suppress(Empty):
                    self._waiting.get_nowait()

    def put_message(self, subscription: int, encoded: bytes) -> None:
        self.put(struct.pack("<BIQ", MESSAGE_DATA, subscription, time.time_ns()) + encoded)

    def end(self) -> None:
        """Send what waits, but not for longer than :data:`PATIENCE_S`, and close."""
        self.put(None)
        self._thread.join(PATIENCE_S)
        if self._thread.is_alive():  # the client does not read: nothing can be told to it
            self._connection.close_socket()
        else:
            self._connection.close()

    def _send(self) -> None:
        from websockets.exceptions import ConnectionClosed

        with suppress(ConnectionClosed, OSError):
            while (data := self._waiting.get()) is not None:
                self._connection.send(data)
