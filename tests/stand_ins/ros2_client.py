"""A client of services and topics as Cyclone's RMW makes them, independent of the package.

Its types come from ROS 2's published definitions: messages from those that rosbags holds, the parts
of services from the texts of rcl_interfaces and std_srvs, which stand here.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from stand_ins.ros2_subscriber import LOCAL, idl_type

SERVICES = {
    "rcl_interfaces/ListParameters": (
        "string[] prefixes\nuint64 depth",
        "rcl_interfaces/ListParametersResult result",
    ),
    "rcl_interfaces/GetParameters": (
        "string[] names",
        "rcl_interfaces/ParameterValue[] values",
    ),
    "rcl_interfaces/GetParameterTypes": ("string[] names", "uint8[] types"),
    "rcl_interfaces/DescribeParameters": (
        "string[] names",
        "rcl_interfaces/ParameterDescriptor[] descriptors",
    ),
    "rcl_interfaces/SetParameters": (
        "rcl_interfaces/Parameter[] parameters",
        "rcl_interfaces/SetParametersResult[] results",
    ),
    "rcl_interfaces/SetParametersAtomically": (
        "rcl_interfaces/Parameter[] parameters",
        "rcl_interfaces/SetParametersResult result",
    ),
    "std_srvs/Trigger": ("", "bool success\nstring message"),
}
"""Service -> its request and its answer, as published."""
PATIENCE_S = 120.0
ANSWER_S = 1.0
"""Time within which a service answers that has seen who asks, s."""


class Client:
    """A participant of ROS 2 ``release`` in a domain."""

    def __init__(self, domain: int, release: str = "JAZZY") -> None:
        from cyclonedds.domain import Domain, DomainParticipant
        from rosbags.typesys import Stores, get_typestore

        self.store = get_typestore(getattr(Stores, f"ROS2_{release}"))
        self._within = Domain(domain, LOCAL)
        self.participant = DomainParticipant(domain)
        self._asked = 0

    def struct(self, name: str) -> Any:
        """Return the type of a message, as ``std_msgs/msg/Bool``."""
        return idl_type(self.store, name)

    def reader(self, topic: str, name: str, *, latched: bool = False) -> Any:
        """Return a reader of a topic, named as on the wire; latched: of what was sent before."""
        from cyclonedds.core import Policy, Qos
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic

        kept = Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile
        sure = Policy.Reliability.Reliable(0) if latched else Policy.Reliability.BestEffort
        qos = Qos(sure, kept, Policy.History.KeepLast(1_000))
        topic = Topic(self.participant, topic, self.struct(name))
        return DataReader(self.participant, topic, qos=qos)

    def endpoints(self, *, writers: bool) -> list[Any]:
        """Return what is known of others' endpoints."""
        from cyclonedds.builtin import (
            BuiltinDataReader,
            BuiltinTopicDcpsPublication,
            BuiltinTopicDcpsSubscription,
        )

        kind = BuiltinTopicDcpsPublication if writers else BuiltinTopicDcpsSubscription
        found = BuiltinDataReader(self.participant, kind).take(256)
        return [one for one in found if getattr(one, "qos", None) is not None]

    def ask(self, name: str, kind: str, **values: Any) -> Any:
        """Ask a service, and return its answer."""
        from cyclonedds.core import Policy, Qos
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic
        from cyclonedds.util import duration

        request, reply = (self._part(kind, part) for part in ("Request", "Response"))
        qos = Qos(
            Policy.Reliability.Reliable(duration(milliseconds=100)),
            Policy.History.KeepLast(10),
            Policy.DataRepresentation(use_cdrv0_representation=True),
        )
        asks = Topic(self.participant, f"rq{name}Request", request)
        tells = Topic(self.participant, f"rr{name}Reply", reply)
        writer = DataWriter(self.participant, asks, qos=qos)
        reader = DataReader(self.participant, tells, qos=qos)
        wait_for(
            lambda: writer.get_matched_subscriptions() and reader.get_matched_publications(),
            f"no service {name}",
        )
        self._asked += 1
        question = request(guid=4_711, seq=self._asked, **values)

        def answered() -> list[Any]:
            """Ask again: an answer is lost where the service has not seen our reader yet."""
            writer.write(question)
            until_s = time.monotonic() + ANSWER_S
            while not (told := reader.take()) and time.monotonic() < until_s:
                time.sleep(0.02)
            return told

        answers = wait_for(answered, f"no answer of {name}")
        assert {(one.guid, one.seq) for one in answers} == {(4_711, self._asked)}
        return answers[0]

    def _part(self, kind: str, part: str) -> Any:
        from cyclonedds.idl import make_idl_struct, types
        from rosbags.typesys import get_types_from_msg

        package, _, short = kind.partition("/")
        text = SERVICES[kind][part == "Response"] or "uint8 structure_needs_at_least_one_member"
        name = f"{package}/msg/{short}_{part}"
        self.store.fielddefs[name] = get_types_from_msg(text, name)[name]
        fields = self.struct(name).__annotations__
        head = {"guid": types.uint64, "seq": types.int64}
        wire = f"{short}_{part}_"
        return make_idl_struct(wire, f"{package}::srv::dds_::{wire}", head | fields)

    def close(self) -> None:
        """Leave the domain."""
        self.participant = None
        del self._within


def wait_for(found: Any, otherwise: str) -> Any:
    """Return what is found, once it is there."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not (value := found()):
        assert time.monotonic() < deadline_s, otherwise
        time.sleep(0.02)
    return value


@contextmanager
def joined(domain: int, release: str = "JAZZY") -> Iterator[Client]:
    """Join a domain for a while."""
    client = Client(domain, release)
    try:
        yield client
    finally:
        client.close()
