"""Hashes of ROS 2 types: what a publisher says of its type since Iron; Humble sends none.

Source: REP-2016, and rosidl_generator_type_description: sha256 of the type's description as JSON,
fields in their order, types that it refers to in the order of their names, no default values.
"""

from __future__ import annotations

import hashlib
import json
from functools import cache
from typing import Any

from spikingtac.ros2.wire.definitions import ALL, element, fields_of, parts_of, ros_type

NESTED, BOUNDED_STRING = 1, 21
TYPE_IDS = {
    "uint8": 3,
    "char": 3,  # an octet since ROS 2, as in rosidl_adapter
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "bool": 15,
    "byte": 16,
    "string": 17,
}
"""Type of a field -> its number (type_description_interfaces/FieldType)."""
ARRAY, BOUNDED_SEQUENCE, SEQUENCE = 48, 96, 144
"""Added to the number of the element's type."""


@cache
def type_hash(message: str) -> str:
    """Return the hash of a type as ROS 2 writes it, ``RIHS01_...``."""
    parts = sorted({ros_type(part): part for part in parts_of(message)}.items())
    described = {
        "type_description": _described(message),
        "referenced_type_descriptions": [_described(part) for _, part in parts],
    }
    return f"RIHS01_{hashlib.sha256(json.dumps(described).encode()).hexdigest()}"


def _described(message: str) -> dict[str, Any]:
    fields = [{"name": name, "type": _field_type(kind)} for kind, name in fields_of(message)]
    return {"type_name": ros_type(message), "fields": fields}


def _field_type(kind: str) -> dict[str, Any]:
    inner, length, bound = element(kind)
    shift = 0 if length is None else ARRAY if length else BOUNDED_SEQUENCE if bound else SEQUENCE
    plain, _, text_bound = inner.partition("<=")
    number = NESTED if inner in ALL else BOUNDED_STRING if text_bound else TYPE_IDS[plain]
    return {
        "type_id": shift + number,
        "capacity": length or bound or 0,
        "string_capacity": int(text_bound or 0),
        "nested_type_name": ros_type(inner) if inner in ALL else "",
    }
