"""ROS 2 messages as bytes: CDR version 1, little endian, as every RMW of Humble and Jazzy reads it.

Source: OMG DDSI-RTPS 2.5, 10.2 (encapsulation), and CORBA 3.4 part 2, 9.3 (CDR): every primitive is
aligned to its own size from the first byte after the encapsulation.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

from spikingtac.ros2.wire.definitions import ALL, element, fields_of

ENCAPSULATION = b"\x00\x01\x00\x00"
"""CDR, little endian, no options."""
PRIMITIVES = {
    "bool": "?",
    "byte": "B",
    "uint8": "B",
    "char": "B",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""Type of a field -> its code in :mod:`struct`; its size is its alignment."""
EMPTY: Mapping[str, Any] = {}
"""A message whose every field is zero, empty, or such a message."""

_Put = Callable[[bytearray, Any], None]


def encode(message: str, values: Mapping[str, Any]) -> bytes:
    """Return a message as bytes.

    Args:
        message: Package and name, as ``std_msgs/Bool``.
        values: Field -> value, messages as mappings; what is missing is zero or empty.

    Raises:
        KeyError: A field is unknown.
        ValueError: An array has another length.
    """
    body = bytearray()
    _message(message)(body, values)
    return ENCAPSULATION + bytes(body)


@cache
def _message(name: str) -> _Put:
    parts = [(field, *_kind(kind)) for kind, field in fields_of(name)]
    known = {field for field, _, _ in parts}

    def put(body: bytearray, values: Mapping[str, Any]) -> None:
        if not known.issuperset(values):
            raise KeyError(f"{name} has no field {sorted(set(values) - known)[0]!r}")
        for field, write, nothing in parts:
            write(body, values.get(field, nothing))

    return put


@cache
def _kind(kind: str) -> tuple[_Put, Any]:
    """Return how a field is written, and what stands where it has no value."""
    if kind == "uint8[]":
        return _bytes, b""
    inner, length, _ = element(kind)
    if length is not None:
        write, nothing = _kind(inner)
        return (_array(write, length), (nothing,) * length) if length else (_sequence(write), ())
    if kind.partition("<=")[0] == "string":
        return _string, ""
    if kind in ALL:
        return _message(kind), EMPTY
    return _primitive(PRIMITIVES[kind]), 0


def _primitive(code: str) -> _Put:
    packer = struct.Struct("<" + code)
    size, pack = packer.size, packer.pack

    def put(body: bytearray, value: Any) -> None:
        body += bytes(-len(body) % size)
        body += pack(value)

    return put


_length = _primitive("I")


def _string(body: bytearray, text: str) -> None:
    raw = text.encode()
    _length(body, len(raw) + 1)
    body += raw
    body.append(0)


def _bytes(body: bytearray, raw: bytes) -> None:
    _length(body, len(raw))
    body += raw


def _sequence(write: _Put) -> _Put:
    def put(body: bytearray, values: Sequence[Any]) -> None:
        _length(body, len(values))
        for value in values:
            write(body, value)

    return put


def _array(write: _Put, length: int) -> _Put:
    def put(body: bytearray, values: Sequence[Any]) -> None:
        if len(values) != length:
            raise ValueError(f"{len(values)} values, an array of {length} is asked for")
        for value in values:
            write(body, value)

    return put
