"""The DDS library's types for ROS 2 messages, and samples of them that are bytes already."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from functools import cache
from typing import Any

from spikingtac.ros2.wire.cdr import ENCAPSULATION, encode
from spikingtac.ros2.wire.definitions import ALL, dds_type, element, fields_of

Asked = tuple[int, int]
"""A client's id, and the number of its request."""


def idl_struct(message: str, *, asked: bool = False) -> Any:
    """Return the library's type of a message, with the name that it has on the wire.

    Args:
        message: Package and name, as ``std_msgs/Bool``.
        asked: Whether an :data:`Asked` comes before it, as in the parts of services.
    """
    return _struct(message, asked)


@cache
def _struct(message: str, asked: bool) -> Any:
    from cyclonedds.idl import make_idl_struct, types

    name = dds_type(message)
    head = {"guid": types.uint64, "seq": types.int64} if asked else {}
    fields = {field: _idl(kind) for kind, field in fields_of(message)}
    return make_idl_struct(name.rpartition("::")[2], name, head | fields)


def sample(message: str, values: Mapping[str, Any], asked: Asked | None = None) -> Any:
    """Return a message for the library to write: its own encoder takes five times as long.

    Args:
        message: Package and name.
        values: As :func:`spikingtac.ros2.wire.cdr.encode` takes them.
        asked: What an answer tells back.
    """
    kind = idl_struct(message, asked=asked is not None)
    made = kind.__new__(kind)
    encoded = encode(message, values)
    if asked is not None:  # 16 bytes: what follows keeps its alignment
        encoded = ENCAPSULATION + struct.pack("<Qq", *asked) + encoded[len(ENCAPSULATION) :]
    object.__setattr__(made, "serialize", lambda **_: encoded)
    return made


def _idl(kind: str) -> Any:
    from cyclonedds.idl import types

    inner, length, bound = element(kind)
    if length:
        return types.array[_idl(inner), length]
    if length == 0:
        return types.sequence[_idl(inner), bound] if bound else types.sequence[_idl(inner)]
    if kind in ALL:
        return idl_struct(kind)
    plain, _, most = kind.partition("<=")
    if most:
        return types.bounded_str[int(most)]
    own = {"string": str, "bool": bool, "byte": types.uint8, "char": types.uint8}
    return own[plain] if plain in own else getattr(types, plain)
