"""What every storage of a bag yields: messages as they were stored."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

Count = Callable[[str], None]
"""Counts one more of a kind of damage."""


class RawMessage(NamedTuple):
    """A message as it was stored; ``cdr`` for ROS 2, else the ROS 1 serialisation."""

    topic: str
    data: bytes
    cdr: bool
    kind: str
