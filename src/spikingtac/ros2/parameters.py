"""The parameters of a node: the services behind ``ros2 param list``, ``get``, ``set`` and others.

Source: rcl_interfaces, and the behaviour of rclcpp's ``parameter_service.cpp``: what is asked for
and unknown has the type "not set", and is left out of the types and descriptions.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from spikingtac.errors import ConfigError
from spikingtac.ros2.dds import DdsPublisher
from spikingtac.ros2.service import Service
from spikingtac.ros2.settings import Settings
from spikingtac.tuning import Control

NOT_SET, BOOL, INTEGER, DOUBLE, STRING = range(5)
"""Numbers of the types (rcl_interfaces/ParameterType)."""
TYPES = {"switch": BOOL, "whole": INTEGER, "number": DOUBLE, "choice": STRING}
"""Kind of a control -> type of its parameter."""
VALUES = {
    BOOL: "bool_value",
    INTEGER: "integer_value",
    DOUBLE: "double_value",
    STRING: "string_value",
}
"""Type -> the field of a ParameterValue that holds it."""
EVENTS = "/parameter_events"
"""Topic on which every node tells what has changed."""
NS_PER_S = 1_000_000_000


class Parameters:
    """Offers settings as the parameters of a node.

    Args:
        publisher: The participant.
        node: Absolute name of the node.
        settings: What can be changed, and what can only be read.

    Attributes:
        services: To be served.
    """

    def __init__(self, publisher: DdsPublisher, node: str, settings: Settings) -> None:
        self._publisher, self._node, self._settings = publisher, node, settings
        publisher.advertise(EVENTS, "rcl_interfaces/ParameterEvent", state=True)
        answers: dict[str, Callable[[Any], Mapping[str, Any]]] = {
            "list_parameters": self.list,
            "get_parameters": self.get,
            "get_parameter_types": self.types,
            "describe_parameters": self.describe,
            "set_parameters": self.set,
            "set_parameters_atomically": self.set_atomically,
        }
        self.services = [
            Service(publisher, f"{node}/{name}", f"rcl_interfaces/{_camel(name)}", answer)
            for name, answer in answers.items()
        ]

    def list(self, asked: Any) -> dict[str, Any]:
        """Answer ListParameters."""
        names = [name for name in self._values() if _listed(name, asked.prefixes, asked.depth)]
        above = {name.rpartition(".")[0] for name in names} - {""}
        return {"result": {"names": names, "prefixes": sorted(above)}}

    def get(self, asked: Any) -> dict[str, Any]:
        """Answer GetParameters."""
        known = self._values()
        return {"values": [known.get(name, {"type": NOT_SET}) for name in asked.names]}

    def types(self, asked: Any) -> dict[str, Any]:
        """Answer GetParameterTypes."""
        known = self._values()
        types = [known[name]["type"] for name in asked.names if name in known]
        return {"types": bytes(types)}

    def describe(self, asked: Any) -> dict[str, Any]:
        """Answer DescribeParameters."""
        known = self._descriptions()
        return {"descriptors": [known[name] for name in asked.names if name in known]}

    def set(self, asked: Any) -> dict[str, Any]:
        """Answer SetParameters: each of them by itself."""
        return {"results": [self._set([parameter]) for parameter in asked.parameters]}

    def set_atomically(self, asked: Any) -> dict[str, Any]:
        """Answer SetParametersAtomically: all of them, or none."""
        return {"result": self._set(asked.parameters)}

    def _set(self, given: Sequence[Any]) -> dict[str, Any]:
        try:
            self._settings.set({one.name: _value_of(one.value) for one in given})
        except ConfigError as error:
            return {"successful": False, "reason": str(error)}
        values, now_ns = self._values(), time.time_ns()
        changed = [{"name": one.name, "value": values[one.name]} for one in given]
        stamp = {"sec": now_ns // NS_PER_S, "nanosec": now_ns % NS_PER_S}
        event = {"stamp": stamp, "node": self._node, "changed_parameters": changed}
        self._publisher.publish(EVENTS, event)
        return {"successful": True, "reason": ""}

    def _values(self) -> dict[str, dict[str, Any]]:
        changeable = ((one.name, TYPES[one.kind], one.value) for one in self._settings.controls())
        fixed = ((name, _type_of(value), value) for name, value in self._settings.fixed.items())
        return {
            name: {"type": kind, VALUES[kind]: value}
            for part in (fixed, changeable)
            for name, kind, value in part
        }

    def _descriptions(self) -> dict[str, dict[str, Any]]:
        told = {
            name: {"name": name, "type": _type_of(value), "read_only": True}
            for name, value in self._settings.fixed.items()
        }
        return told | {one.name: _described(one) for one in self._settings.controls()}


def _listed(name: str, prefixes: Sequence[str], depth: int) -> bool:
    """Tell whether a name lies below one of the prefixes, and not too deep; depth 0 is any."""
    below: Iterator[str] = (
        name.removeprefix(f"{prefix}.")
        for prefix in prefixes
        if name == prefix or name.startswith(f"{prefix}.")
    )
    rest = next(below, None) if prefixes else name
    return rest is not None and (depth == 0 or rest.count(".") < depth)


def _described(control: Control) -> dict[str, Any]:
    span = {"from_value": control.low, "to_value": control.high}
    about = " ".join(part for part in (control.about, control.unit and f"[{control.unit}]") if part)
    told: dict[str, Any] = {
        "name": control.name,
        "type": TYPES[control.kind],
        "description": about,
    }
    if control.kind == "number":
        told["floating_point_range"] = [span]
    if control.kind == "whole":
        told["integer_range"] = [{side: round(value) for side, value in span.items()} | {"step": 1}]
    if control.kind == "choice":
        told["additional_constraints"] = f"one of: {', '.join(control.choices)}"
    return told


def _value_of(value: Any) -> Any:
    """Return what a ParameterValue holds; a list of values, which no setting takes, is itself."""
    return getattr(value, VALUES[value.type]) if value.type in VALUES else value


def _type_of(value: str | float) -> int:
    return STRING if isinstance(value, str) else DOUBLE


def _camel(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))
