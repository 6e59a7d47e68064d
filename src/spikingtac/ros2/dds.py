"""A DDS participant that publishes topics as ROS 2 names them, with their types, hashes and QoS.

Sources: the topic and type names of https://design.ros2.org/articles/topic_and_service_names.html;
the structure of the types as rmw_cyclonedds makes them (``dyntype.cpp``: final, plain member names,
bytes as uint8); ``typehash=RIHS01_...;`` in USER_DATA as rmw_dds_common writes it since Iron.
"""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from spikingtac.errors import ConfigError, DeviceError, MissingExtraError
from spikingtac.ros2.types import idl_struct, sample, type_hash

LOOPBACK = "lo"  # The interface name that stands for this machine alone.
LARGEST_DOMAIN = 101  # Above it the ports of ROS 2 domains meet those that Linux gives away.
SENSOR_DEPTH = 5  # Depth of the history of the profile "sensor data" (rmw, ``qos_profiles.h``).

# Messages that are kept to be sent again: a second at 1 kHz, 2.4 MB of fields (ours).
RELIABLE_DEPTH = 1_000

# Processes with a participant on one machine, as rmw_cyclonedds sets it for localhost.
MOST_PARTICIPANTS = 32
_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")


@dataclass(frozen=True, kw_only=True, slots=True)
class DdsConfig:
    """How a participant is reached.

    Attributes:
        domain: ROS_DOMAIN_ID, 0 to 101.
        interface: Name or address of a network interface, or ``lo``: this machine alone.
        reliable: Send again what got lost; sensor data are best effort otherwise.
    """

    domain: int = 0
    interface: str = LOOPBACK
    reliable: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.domain <= LARGEST_DOMAIN:
            raise ConfigError(f"the domain is {self.domain}, it must be 0 to {LARGEST_DOMAIN}")
        known = [name for _, name in socket.if_nameindex()]
        if self.interface not in (LOOPBACK, *known) and not _is_address(self.interface):
            raise ConfigError(
                f"{self.interface!r} is no network interface (valid: {', '.join(known)}, or an "
                "address of one)"
            )

    def document(self) -> str:
        """Return the settings of Cyclone DDS, as XML."""
        if self.interface == LOOPBACK:
            where, peers = 'address="127.0.0.1" multicast="false"', _LOCAL_PEERS
        else:
            kind = "address" if _is_address(self.interface) else "name"
            where, peers = f'{kind}="{self.interface}"', ""
        return (
            f"<CycloneDDS><Domain><General><Interfaces><NetworkInterface {where}/></Interfaces>"
            f"</General>{peers}</Domain></CycloneDDS>"
        )


_LOCAL_PEERS = (
    "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
    f"<MaxAutoParticipantIndex>{MOST_PARTICIPANTS}</MaxAutoParticipantIndex>"
    '<Peers><Peer address="localhost"/></Peers></Discovery>'
)


def dds_topic(topic: str) -> str:
    """Return the name of a ROS topic on the wire.

    Raises:
        ConfigError: It is no absolute name of a topic.
    """
    if not _TOPIC.fullmatch(topic):
        raise ConfigError(
            f"{topic!r} is no name of a topic; valid are letters, digits and _ between slashes, "
            "as /tactile/left"
        )
    return f"rt{topic}"


class DdsPublisher:
    """Publishes messages; without a reader, a message costs no more than its bytes.

    Args:
        config: Domain and interface.

    Raises:
        MissingExtraError: cyclonedds is not installed.
        DeviceError: The domain cannot be entered.
    """

    def __init__(self, config: DdsConfig) -> None:
        try:
            from cyclonedds import core, domain
        except ImportError as error:
            raise MissingExtraError(
                "ROS 2 needs cyclonedds; install it with: pip install 'spikingtac[ros2]'"
            ) from error
        self._config = config
        self._participant: Any = None
        self._topics: dict[str, tuple[str, Any]] = {}
        try:
            self._domain = domain.Domain(config.domain, config.document())
            # ROS 2 takes a participant for one of its own by its enclave.
            qos = core.Qos(core.Policy.Userdata(b"enclave=/;"))
            self._participant = domain.DomainParticipant(config.domain, qos=qos)
        except core.DDSException as error:
            raise DeviceError(
                f"DDS domain {config.domain} cannot be entered on {config.interface!r}: {error}; "
                "another --domain or --interface may be free"
            ) from error

    def advertise(self, topic: str, message: str, *, state: bool = False) -> None:
        """Announce a topic.

        Args:
            topic: Absolute name, as ``/tactile/field``.
            message: Package and name, as ``std_msgs/Bool``.
            state: The last message is kept for those who come later, and is sent for certain.

        Raises:
            ConfigError: The name is none.
        """
        from cyclonedds.pub import DataWriter
        from cyclonedds.topic import Topic

        qos = topic_qos(message, state=state, reliable=self._config.reliable)
        announced = Topic(self._participant, dds_topic(topic), idl_struct(message))
        self._topics[topic] = (message, DataWriter(self._participant, announced, qos=qos))

    def publish(self, topic: str, values: Mapping[str, Any]) -> None:
        """Send a message, without waiting for slow readers.

        Raises:
            DeviceError: It could not be sent.
        """
        from cyclonedds.core import DDSException

        message, writer = self._topics[topic]
        try:
            writer.write(sample(message, values))
        except DDSException as error:
            raise DeviceError(f"{topic} cannot be published: {error}") from error

    def readers(self, topic: str) -> int:
        """Return how many readers a topic has now."""
        return len(self._topics[topic][1].get_matched_subscriptions())

    def close(self) -> None:
        """Leave the domain: readers see the topics end."""
        self._topics.clear()
        self._participant = None
        del self._domain


def topic_qos(message: str, *, state: bool, reliable: bool) -> Any:
    """Return the quality of service of a topic.

    Args:
        message: Package and name.
        state: The last message is kept for those who come later, and is sent for certain.
        reliable: Messages are sent again where they got lost.
    """
    from cyclonedds.core import Policy, Qos
    from cyclonedds.util import duration

    sure = Policy.Reliability.Reliable(duration(milliseconds=0))
    return Qos(
        sure if state or reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if state else Policy.Durability.Volatile,
        Policy.History.KeepLast(1 if state else RELIABLE_DEPTH if reliable else SENSOR_DEPTH),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(f"typehash={type_hash(message)};".encode()),
    )


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True
