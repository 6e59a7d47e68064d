"""A service of ROS 2 without arguments, ``std_srvs/Trigger``, as Cyclone's RMW speaks it.

A request goes to the topic ``rq/NAMERequest``, its answer to ``rr/NAMEReply``. Both begin with the
client's id and the request's number (``cdds_request_header_t`` of rmw_cyclonedds): the answer tells
them back, and the client takes its own. Other RMWs (Fast DDS) put them elsewhere on the wire, and
do not reach this service.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from spikingtac.ros2.dds import DdsPublisher, dds_topic

DEPTH = 10
"""Requests that wait, as the profile of services has it (rmw, ``qos_profiles.h``)."""
PACKAGE = "std_srvs::srv::dds_::"

Answer = Callable[[], tuple[bool, str]]
"""Does what was asked for; returns whether it did, and a sentence."""


class TriggerService:
    """Answers requests when it is asked to look for them.

    Args:
        publisher: The participant.
        name: Absolute name of the service, as ``/tactile/reset``.
        answer: Does what is asked for.

    Raises:
        ConfigError: The name is none.
    """

    def __init__(self, publisher: DdsPublisher, name: str, answer: Answer) -> None:
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic

        plain = dds_topic(name).removeprefix("rt")
        participant, qos = publisher.participant, _qos()
        asked = Topic(participant, f"rq{plain}Request", request_type())
        told = Topic(participant, f"rr{plain}Reply", reply_type())
        self._reader = DataReader(participant, asked, qos=qos)
        self._writer = DataWriter(participant, told, qos=qos)
        self._answer = answer

    def serve(self) -> int:
        """Answer what has come; return how many requests there were."""
        requests = self._reader.take(N=DEPTH)
        for request in requests:
            success, message = self._answer()
            reply = {"guid": request.guid, "seq": request.seq}
            self._writer.write(reply_type()(**reply, success=success, message=message))
        return len(requests)


@cache
def request_type() -> Any:
    """Return the type of a request; what has no field has one byte, as in every RMW."""
    from cyclonedds.idl import types

    return _type("Trigger_Request_", {"structure_needs_at_least_one_member": types.uint8})


@cache
def reply_type() -> Any:
    """Return the type of an answer."""
    return _type("Trigger_Response_", {"success": bool, "message": str})


def _type(name: str, fields: dict[str, Any]) -> Any:
    from cyclonedds.idl import make_idl_struct, types

    header = {"guid": types.uint64, "seq": types.int64}
    return make_idl_struct(name, PACKAGE + name, header | fields)


def _qos() -> Any:
    from cyclonedds.core import Policy, Qos
    from cyclonedds.util import duration

    return Qos(
        Policy.Reliability.Reliable(duration(milliseconds=100)),
        Policy.Durability.Volatile,
        Policy.History.KeepLast(DEPTH),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
