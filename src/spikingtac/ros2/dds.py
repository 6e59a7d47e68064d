"""A DDS participant that publishes topics as ROS 2 names them, with their types, hashes and QoS.

Sources: the topic and type names of https://design.ros2.org/articles/topic_and_service_names.html;
the structure of the types as rmw_cyclonedds makes them (``dyntype.cpp``: final, plain member names,
bytes as uint8); ``typehash=RIHS01_...;`` in USER_DATA as rmw_dds_common writes it since Iron.
"""

import ipaddress
import socket
from collections.abc import Mapping
from typing import Any

from spikingtac.errors import ConfigError, DeviceError, import_extra
from spikingtac.ros2.messages import OCTETS, encode, ros_type, type_store

LOOPBACK = "lo"  # The interface name that stands for this machine alone.
LARGEST_DOMAIN = 101  # Above it the ports of ROS 2 domains meet those that Linux gives away.
SENSOR_DEPTH = 5  # Depth of the history of the profile "sensor data" (rmw, ``qos_profiles.h``).

# Messages that are kept to be sent again: a second at 1 kHz, 2.4 MB of fields.
RELIABLE_DEPTH = 1_000

# Settings of Cyclone DDS: the interface; for this machine alone also where other participants are,
# of which there are at most 32, as rmw_cyclonedds sets it for localhost.
SETTINGS = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface {where}/></Interfaces></General>"
    "{peers}</Domain></CycloneDDS>"
)
LOCAL_PEERS = (
    "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
    '<Peers><Peer address="localhost"/></Peers></Discovery>'
)


def _settings(interface: str) -> str:
    """Return the settings of Cyclone DDS, as XML.

    Raises:
        ConfigError: There is no such interface.
    """
    known = [name for _, name in socket.if_nameindex()]
    if interface == LOOPBACK:
        return SETTINGS.format(where='address="127.0.0.1" multicast="false"', peers=LOCAL_PEERS)
    try:
        at = "" if interface in known else ipaddress.ip_address(interface)
    except ValueError as error:
        raise ConfigError(
            f"{interface!r} is no network interface (valid: {', '.join(known)}, or an address of "
            "one)"
        ) from error
    where = f'address="{at}"' if at else f'name="{interface}"'
    return SETTINGS.format(where=where, peers="")


class DdsPublisher:
    """Publishes messages; without a reader, a message costs no more than its bytes.

    It is a :class:`~spikingtac.ros2.messages.Publisher`.

    Args:
        domain: ROS_DOMAIN_ID, 0 to 101.
        interface: Name or address of a network interface, or ``lo``: this machine alone.
        reliable: Send again what got lost; sensor data are best effort otherwise.

    Raises:
        ConfigError: Domain or interface are not valid.
        MissingExtraError: cyclonedds is not installed.
        DeviceError: The domain cannot be entered.
    """

    def __init__(self, domain: int, interface: str, reliable: bool = False) -> None:
        if not 0 <= domain <= LARGEST_DOMAIN:
            raise ConfigError(f"the domain is {domain}, it must be 0 to {LARGEST_DOMAIN}")
        settings = _settings(interface)
        import_extra("cyclonedds", "ROS 2", "ros2")
        from cyclonedds import core
        from cyclonedds import domain as entered

        self._reliable = reliable
        self._topics: dict[str, tuple[str, Any, Any]] = {}  # message, its type, writer
        try:
            self._domain = entered.Domain(domain, settings)
            # ROS 2 takes a participant for one of its own by its enclave.
            qos = core.Qos(core.Policy.Userdata(b"enclave=/;"))
            self._participant: Any = entered.DomainParticipant(domain, qos=qos)
        except core.DDSException as error:
            raise DeviceError(
                f"DDS domain {domain} cannot be entered on {interface!r}: {error}; "
                "another --domain or --interface may be free"
            ) from error

    def advertise(self, topic: str, message: str, *, state: bool = False) -> None:
        """Announce a topic."""
        from cyclonedds.core import Policy, Qos
        from cyclonedds.pub import DataWriter
        from cyclonedds.topic import Topic

        reliable, name = self._reliable, ros_type(message)
        sure = Policy.Reliability.Reliable(0)  # the time that a write may wait, ns
        qos = Qos(
            sure if state or reliable else Policy.Reliability.BestEffort,
            Policy.Durability.TransientLocal if state else Policy.Durability.Volatile,
            Policy.History.KeepLast(1 if state else RELIABLE_DEPTH if reliable else SENSOR_DEPTH),
            Policy.DataRepresentation(use_cdrv0_representation=True),
            Policy.Userdata(f"typehash={type_store().hash_rihs01(name)};".encode()),
        )
        kind = _idl_struct(name)
        announced = Topic(self._participant, f"rt{topic}", kind)
        self._topics[topic] = message, kind, DataWriter(self._participant, announced, qos=qos)

    def publish(self, topic: str, values: Mapping[str, Any], t_ns: int) -> None:
        """Send a message; its time stands in its header.

        Raises:
            DeviceError: It could not be sent.
        """
        from cyclonedds.core import DDSException

        message, kind, writer = self._topics[topic]
        sample = kind.__new__(kind)
        encoded = encode(message, values)
        # The library's own encoder takes five times as long.
        object.__setattr__(sample, "serialize", lambda **_: encoded)
        try:
            writer.write(sample)
        except DDSException as error:
            raise DeviceError(f"{topic} cannot be published: {error}") from error

    def readers(self, topic: str) -> int:
        """Return how many readers a topic has now."""
        return len(self._topics[topic][2].get_matched_subscriptions())

    def close(self) -> None:
        """Leave the domain: readers see the topics end."""
        self._topics.clear()
        self._participant = None
        del self._domain


def _idl_struct(name: str) -> Any:
    """Return Cyclone DDS's type of a message, named as on the wire."""
    from cyclonedds.idl import make_idl_struct, types
    from rosbags.interfaces import Nodetype

    own = {"string": str, "bool": bool} | dict.fromkeys(OCTETS, types.uint8)

    def idl(node: Any) -> Any:
        kind, what = node
        if kind == Nodetype.NAME:
            return _idl_struct(what)
        if kind == Nodetype.BASE:
            return own[what[0]] if what[0] in own else getattr(types, what[0])
        inner, length = idl(what[0]), what[1]
        return types.array[inner, length] if kind == Nodetype.ARRAY else types.sequence[inner]

    package, _, short = name.split("/")
    fields = {field: idl(node) for field, node in type_store().fielddefs[name][1]}
    return make_idl_struct(f"{short}_", f"{package}::msg::dds_::{short}_", fields)
