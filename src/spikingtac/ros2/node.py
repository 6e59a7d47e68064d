"""A participant's node: ``ros2 node list`` shows it, and ``ros2 param`` finds its services.

Source: rmw_dds_common, which every DDS RMW uses: each participant tells on the topic
``ros_discovery_info`` which of its readers and writers belong to which node.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

from spikingtac.ros2.dds import DdsPublisher, topic_qos
from spikingtac.ros2.wire.idl import sample
from spikingtac.ros2.wire.service_definitions import HUMBLE

Release = Literal["jazzy", "humble"]
INFO = "rmw_dds_common/ParticipantEntitiesInfo"
GID_BYTES = {"jazzy": 16, "humble": 24}
"""Length of an endpoint's id in the messages of a release; 16 since Iron."""


class Node:
    """Announces a participant's topics and services to ROS 2 as those of a node.

    Args:
        publisher: The participant, with all its topics and services.
        name: Absolute name of the node, as ``/hand/left``.
        release: Release of those who listen.
    """

    def __init__(self, publisher: DdsPublisher, name: str, release: Release = "jazzy") -> None:
        message = INFO + (HUMBLE if release == "humble" else "")
        size = GID_BYTES[release]
        qos = topic_qos(message, state=True, reliable=True)
        self._writer = publisher.writer("ros_discovery_info", message, qos)
        namespace, _, short = name.rpartition("/")
        node = {
            "node_namespace": namespace or "/",
            "node_name": short,
            "reader_gid_seq": list(_ids(publisher.own_readers, size)),
            "writer_gid_seq": list(_ids(publisher.own_writers, size)),
        }
        (own,) = _ids([publisher.participant], size)
        told = {"gid": own, "node_entities_info_seq": [node]}
        self._writer.write(sample(message, told))


def _ids(entities: Iterable[Any], size: int) -> Iterable[dict[str, bytes]]:
    for entity in entities:
        yield {"data": entity.get_guid().bytes.ljust(size, b"\0")}
