"""Services of ROS 2 as Cyclone's RMW speaks them.

A request goes to the topic ``rq/NAMERequest``, its answer to ``rr/NAMEReply``. Both begin with the
client's id and the request's number (``cdds_request_header_t`` of rmw_cyclonedds): the answer tells
them back, and the client takes its own. Both endpoints name one ``serviceid``, by which a client
knows that they belong together. Other RMWs (Fast DDS) put the number elsewhere on the wire, and do
not reach these services. Neither may those releases of rmw_cyclonedds that announce the types of
services (``dyntype.cpp``, 2025): what they announce lacks the id and the number that they send, and
the library used here can announce a type only as it is sent.
"""

from __future__ import annotations

import threading
import uuid
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from spikingtac.ros2.dds import DdsPublisher, dds_topic
from spikingtac.ros2.wire.idl import idl_struct, sample
from spikingtac.ros2.wire.type_hash import type_hash

DEPTH = 10
"""Requests that wait, as the profile of services has it (rmw, ``qos_profiles.h``)."""
LOOK_MS = 100
"""Time between two looks whether to end, ms; requests are answered at once."""
PATIENCE_S = 2.0
"""Time for the last answer."""

Answer = Callable[[Any], Mapping[str, Any]]
"""Does what a request asks for; returns the fields of the answer."""


class Service:
    """Answers waiting requests when it is called.

    Args:
        publisher: The participant.
        name: Absolute name of the service, as ``/tactile/reset``.
        kind: Package and name of its type, as ``std_srvs/Trigger``.
        answer: Does what is asked for.

    Attributes:
        reader: The library's reader of requests.

    Raises:
        ConfigError: The name is none.
    """

    def __init__(self, publisher: DdsPublisher, name: str, kind: str, answer: Answer) -> None:
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic

        plain, identity = dds_topic(name).removeprefix("rt"), uuid.uuid4()
        request, self._reply = f"{kind}_Request", f"{kind}_Response"
        asked, told = (idl_struct(part, asked=True) for part in (request, self._reply))
        self.reader = DataReader(
            publisher.participant,
            Topic(publisher.participant, f"rq{plain}Request", asked),
            qos=_qos(request, identity),
        )
        self._writer = DataWriter(
            publisher.participant,
            Topic(publisher.participant, f"rr{plain}Reply", told),
            qos=_qos(self._reply, identity),
        )
        publisher.own_readers.append(self.reader)
        publisher.own_writers.append(self._writer)
        self._answer = answer

    def serve(self) -> int:
        """Answer what has come; return how many requests there were."""
        requests = [one for one in self.reader.take(N=DEPTH) if hasattr(one, "seq")]
        for request in requests:
            values = self._answer(request)
            self._writer.write(sample(self._reply, values, (request.guid, request.seq)))
        return len(requests)


class Desk:
    """Answers the requests of services in a thread of its own, also while a sensor is silent.

    Args:
        publisher: The participant.
        services: Their answers are given one after the other.
    """

    def __init__(self, publisher: DdsPublisher, services: Sequence[Service]) -> None:
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet

        self._services, self._ending = services, threading.Event()
        self._waiting = WaitSet(publisher.participant)
        unread = SampleState.NotRead | ViewState.Any | InstanceState.Any
        for service in services:
            self._waiting.attach(ReadCondition(service.reader, unread))
        self._thread = threading.Thread(target=self._serve, name="services", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Answer no more; to be called before the participant leaves."""
        self._ending.set()
        self._thread.join(PATIENCE_S)

    def _serve(self) -> None:
        from cyclonedds.util import duration

        while not self._ending.is_set():
            if self._waiting.wait(timeout=duration(milliseconds=LOOK_MS)):
                for service in self._services:
                    service.serve()


def _qos(part: str, identity: uuid.UUID) -> Any:
    from cyclonedds.core import Policy, Qos
    from cyclonedds.util import duration

    octets = ".".join(f"{octet:02x}" for octet in identity.bytes)
    return Qos(
        Policy.Reliability.Reliable(duration(milliseconds=100)),
        Policy.Durability.Volatile,
        Policy.History.KeepLast(DEPTH),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(f"serviceid={octets};typehash={type_hash(part)};".encode()),
    )
