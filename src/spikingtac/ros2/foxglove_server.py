"""A Foxglove server: the topics of ROS 2 over a web socket, for users of the app without ROS.

Messages are those of :mod:`spikingtac.ros2.dds`, byte by byte, with ROS 2's definitions as schemas,
so that Foxglove's panels show them as they show a bag. Settings are Foxglove's parameters.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from spikingtac.errors import ConfigError, DeviceError, MissingExtraError
from spikingtac.ros2.settings import Settings
from spikingtac.ros2.wire.cdr import encode
from spikingtac.ros2.wire.definitions import full_definition, ros_type

LOOPBACK = "127.0.0.1"
BACKLOG = 256
"""Messages that wait for a slow client; the oldest are dropped then (ours: 4 s of a display)."""
LARGEST_PORT = 65_535


@dataclass(frozen=True, kw_only=True, slots=True)
class FoxgloveConfig:
    """Where the server listens.

    Attributes:
        host: Address of an interface of this machine; loopback is this machine alone.
        port: Port, or 0 for any free one.
        name: Shown by the app.
    """

    host: str = LOOPBACK
    port: int = 8766
    name: str = "spikingtac"

    def __post_init__(self) -> None:
        if not 0 <= self.port <= LARGEST_PORT:
            raise ConfigError(f"the port is {self.port}, it must be 0 to {LARGEST_PORT}")
        try:
            ipaddress.ip_address(self.host)
        except ValueError as error:
            raise ConfigError(
                f"{self.host!r} is no address; valid are those of this machine, as {LOOPBACK}"
            ) from error


class FoxglovePublisher:
    """Serves messages to the clients that subscribe, without waiting for slow ones.

    Args:
        config: Where it listens.
        settings: What clients may see and change, between two frames.

    Attributes:
        port: On which it listens.

    Raises:
        MissingExtraError: foxglove-sdk is not installed.
        DeviceError: The port is taken, or the address is none of this machine.
    """

    def __init__(self, config: FoxgloveConfig, settings: Settings) -> None:
        try:
            import foxglove
        except ImportError as error:
            raise MissingExtraError(
                "Foxglove needs foxglove-sdk; install it with: pip install 'spikingtac[foxglove]'"
            ) from error
        self._context = foxglove.Context()  # another server of this process has its own
        self._channels: dict[str, tuple[str, Any]] = {}
        self._listener = _Listener(settings)
        listener: Any = self._listener  # the library calls what it finds
        try:
            self._server = foxglove.start_server(
                name=config.name,
                host=config.host,
                port=config.port,
                capabilities=[foxglove.Capability.Parameters],
                server_listener=listener,
                context=self._context,
                message_backlog_size=BACKLOG,
            )
        except (OSError, RuntimeError) as error:
            raise DeviceError(
                f"Foxglove cannot be served on {config.host}:{config.port}: {error}; another "
                "--port may be free (0 takes any)"
            ) from error
        self.port: int = self._server.port

    def advertise(self, topic: str, message: str, *, state: bool = False) -> None:
        """Announce a topic.

        Args:
            topic: Absolute name, as ``/tactile/field``.
            message: Package and name, as ``std_msgs/Bool``.
            state: The last message is given to those who come later.
        """
        from foxglove import Channel, Schema

        definition = full_definition(message).encode()
        schema = Schema(name=ros_type(message), encoding="ros2msg", data=definition)
        channel = Channel(topic, schema=schema, message_encoding="cdr", context=self._context)
        self._channels[topic] = (message, channel)
        if state:
            self._listener.states[channel.id()] = (channel, None)

    def publish(self, topic: str, values: Mapping[str, Any]) -> None:
        """Send a message; without a subscriber it is not even encoded."""
        message, channel = self._channels[topic]
        kept = channel.id() in self._listener.states
        if not kept and not channel.has_sinks():
            return
        encoded = encode(message, values)
        if kept:
            self._listener.states[channel.id()] = (channel, encoded)
        channel.log(encoded)

    def readers(self, topic: str) -> int:
        """Return whether a topic has subscribers now, 0 or 1."""
        return int(self._channels[topic][1].has_sinks())

    def close(self) -> None:
        """Let all clients go."""
        self._server.stop()
        for _, channel in self._channels.values():
            channel.close()


class _Listener:
    """What clients ask of the server; called in threads of the library's own."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.states: dict[int, tuple[Any, bytes | None]] = {}

    def on_subscribe(self, client: Any, channel: Any) -> None:
        known, encoded = self.states.get(channel.id, (None, None))
        if known is not None and encoded is not None:
            known.log(encoded)

    def on_get_parameters(
        self, client: Any, param_names: list[str], request_id: str | None = None
    ) -> list[Any]:
        from foxglove import Parameter

        values: dict[str, Any] = dict(self._settings.fixed)
        values |= {control.name: control.value for control in self._settings.controls()}
        names = param_names or list(values)
        return [Parameter(name, value=values[name]) for name in names if name in values]

    def on_set_parameters(
        self, client: Any, parameters: list[Any], request_id: str | None = None
    ) -> list[Any]:
        for parameter in parameters:
            try:
                self._settings.set({parameter.name: parameter.get_value()})
            except ConfigError:
                continue  # the answer below tells what holds
        return self.on_get_parameters(client, [parameter.name for parameter in parameters])

    def __getattr__(self, name: str) -> Any:
        if name.startswith("on_"):  # what else the library may call
            return lambda *_: None
        raise AttributeError(name)
