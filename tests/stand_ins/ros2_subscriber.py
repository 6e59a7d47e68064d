"""A participant of its own: reads a topic with types made from ROS 2's published definitions.

Run as a process: ``ros2_subscriber.py DOMAIN TOPIC TYPE OUTPUT COUNT SECONDS [reliable] [slow]``.
It uses none of this package's code: its types come from the definitions of Humble that rosbags
holds, its bytes are decoded by the DDS library. It writes what it read to OUTPUT (.npz), and ends
when it has COUNT messages or after SECONDS. With ``slow`` it takes nothing until the end.
"""

import sys
import time
from typing import Any

import numpy as np

LOCAL = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1" '
    'multicast="false"/></Interfaces></General><Discovery><ParticipantIndex>auto'
    '</ParticipantIndex><Peers><Peer address="localhost"/></Peers></Discovery></Domain>'
    "</CycloneDDS>"
)


def idl_type(store: Any, name: str) -> Any:
    """Return the DDS library's type for a ROS type."""
    from cyclonedds.idl import make_idl_struct, types
    from rosbags.interfaces import Nodetype

    def of(node: Any) -> Any:
        kind, what = node
        if kind == Nodetype.BASE:
            if what[0] == "string" and what[1]:
                return types.bounded_str[what[1]]
            # Chars and bytes are octets since ROS 2 (rosidl_adapter).
            own = dict.fromkeys(("octet", "char", "byte"), types.uint8)
            own |= {"string": str, "bool": bool}
            return own[what[0]] if what[0] in own else getattr(types, what[0])
        if kind == Nodetype.NAME:
            return idl_type(store, what)
        inner = of(what[0])
        if kind == Nodetype.ARRAY:
            return types.array[inner, what[1]]
        return types.sequence[inner, what[1]] if what[1] else types.sequence[inner]

    package, _, short = name.split("/")
    fields = {field: of(node) for field, node in store.fielddefs[name][1]}
    return make_idl_struct(f"{short}_", f"{package}::msg::dds_::{short}_", fields)


def main() -> None:
    """Read and write what was read."""
    from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import Domain, DomainParticipant
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from rosbags.typesys import Stores, get_typestore

    domain, topic, name, output, count, seconds = sys.argv[1:7]
    kind = idl_type(get_typestore(Stores.ROS2_HUMBLE), name)
    entered = Domain(int(domain), LOCAL)
    participant = DomainParticipant(int(domain))
    announced = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
    sure = "reliable" in sys.argv[7:]
    slow = "slow" in sys.argv[7:]
    qos = Qos(
        Policy.Reliability.Reliable(0) if sure else Policy.Reliability.BestEffort,
        Policy.History.KeepLast(1) if slow else Policy.History.KeepAll,
    )
    reader = DataReader(participant, Topic(participant, topic, kind), qos=qos)
    print("READY", flush=True)
    samples: list[Any] = []
    told: set[tuple[str, str, str]] = set()
    deadline = time.monotonic() + float(seconds)
    while time.monotonic() < deadline and len(samples) < int(count):
        time.sleep(0.002)
        for one in announced.take(64):
            if getattr(one, "qos", None) is not None:  # it has not ended meanwhile
                given = one.qos[Policy.Userdata]
                data = b"" if given is None else bytes(given.data)
                told.add((one.topic_name, one.type_name, data.decode()))
        samples += [] if slow else [one for one in reader.take(4_096) if hasattr(one, "header")]
    stamps = [s.header.stamp.sec * 10**9 + s.header.stamp.nanosec for s in samples]
    np.savez(
        output,
        t_ns=np.array(stamps, np.int64),
        data=np.array([bytes(s.data) for s in samples]),
        names=np.array([[f.name for f in s.fields] for s in samples[:1]]),
        shape=np.array([(s.height, s.width, s.point_step) for s in samples[:1]]),
        told=np.array(sorted(told)),
    )
    del entered


if __name__ == "__main__":
    main()
