"""Messages of a page: frames and greetings to it, commands from it.

A frame is, little-endian: ``STV1``, uint32 length of the JSON, the JSON padded with spaces so that
the arrays begin at a multiple of 8 bytes, then the arrays, each padded likewise. The JSON's
``arrays`` lists ``[name, dtype, shape, offset from the first array]``, so that a reader needs no
other description.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Largest frame: two packed images of 640x640, and the markers of any grid in use.
FRAME_BYTES = 2 << 20
GREETING_BYTES = 1 << 20  # Largest description of a view, which a page gets once.
STOP = ("stop", None)  # The last command of a session; pages cannot send it.
MAGIC = b"STV1"
PREFIX = struct.Struct("<4sI")
ALIGNED = 8  # The widest item that a typed array in a browser may start at, bytes.


def encode(meta: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return one message.

    Args:
        meta: Scalars and short lists that JSON can hold; the key ``arrays`` is taken.
        arrays: Little-endian arrays by name, of any shape.
    """
    listed, parts, offset = [], [], 0
    for name, array in arrays.items():
        body = np.ascontiguousarray(array).tobytes()
        listed.append([name, array.dtype.str.lstrip("<|"), list(array.shape), offset])
        parts.append(body + bytes(-len(body) % ALIGNED))
        offset += len(parts[-1])
    text = json.dumps({**meta, "arrays": listed}, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-(len(text) + PREFIX.size) % ALIGNED)
    return b"".join((PREFIX.pack(MAGIC, len(text)), text, *parts))


LONGEST_COMMAND = 1024  # Characters; a page never needs more.
SLOWEST, FASTEST = 0.01, 10.0  # Speeds of playback, relative to the recording's own time.
SHORTEST_EXPOSURE_US, LONGEST_EXPOSURE_US = 500, 500_000
LATEST_US = 1 << 53  # Integers beyond it are not exact in a browser.


class CommandError(ValueError):
    """A message from a page that is no command."""


def parse_command(text: str) -> tuple[str, Any]:
    """Return ``(name, value)`` of a command.

    Commands are JSON objects of one key: ``ack``, ``play``, ``speed``, ``seek_us``,
    ``exposure_us``, ``map``, ``set`` (a list of a control's name and its value), ``defaults``,
    ``reset`` (of the stream's fault), ``calibrate`` or ``begin_anew`` (the guide of a calibration).

    Raises:
        CommandError: The text is anything else.
    """
    if len(text) > LONGEST_COMMAND:
        raise CommandError(f"{len(text)} characters, at most {LONGEST_COMMAND} are valid")
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise CommandError("no JSON") from error
    if not isinstance(document, dict) or len(document) != 1:
        raise CommandError("a command is a JSON object of one key")
    ((name, value),) = document.items()
    fits = _RULES.get(name)
    if fits is None or not fits(value):
        raise CommandError(f"{name!r} is unknown, or its value is out of range")
    return name, value


def _whole(low: int, high: int) -> Callable[[Any], bool]:
    return lambda value: type(value) is int and low <= value <= high


def _setting(value: Any) -> bool:
    if not isinstance(value, list) or len(value) != 2 or not isinstance(value[0], str):
        return False
    return isinstance(value[1], bool | int | float | str)


# Command -> whether a value fits it.
_RULES: dict[str, Callable[[Any], bool]] = {
    "ack": _whole(0, LATEST_US),
    "play": lambda value: isinstance(value, bool),
    "speed": lambda value: type(value) in (int, float) and SLOWEST <= value <= FASTEST,
    "seek_us": _whole(-LATEST_US, LATEST_US),
    "exposure_us": _whole(SHORTEST_EXPOSURE_US, LONGEST_EXPOSURE_US),
    "map": lambda value: isinstance(value, bool),
    "set": _setting,
    **dict.fromkeys(("defaults", "reset", "calibrate", "begin_anew"), lambda value: value is True),
}
