"""The binary message of a displayed frame: JSON for the scalars, raw arrays for the rest.

Layout, little-endian: ``STV1``, uint32 length of the JSON, the JSON padded with spaces so that the
arrays begin at a multiple of 8 bytes, then the arrays, each padded likewise. The JSON's ``arrays``
lists ``[name, dtype, shape, offset from the first array]``, so that a reader needs no other
description.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

FRAME_BYTES = 2 << 20
"""Largest frame: two packed images of 640x640, and the markers of any grid in use."""
GREETING_BYTES = 1 << 20
"""Largest description of a view, which a page gets once."""
STOP = ("stop", None)
"""The last command of a session; pages cannot send it."""
MAGIC = b"STV1"
_PREFIX = struct.Struct("<4sI")
_ALIGN = 8  # the widest item that a typed array in a browser may start at


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
        parts.append(body + bytes(-len(body) % _ALIGN))
        offset += len(parts[-1])
    text = json.dumps({**meta, "arrays": listed}, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-(len(text) + _PREFIX.size) % _ALIGN)
    return b"".join((_PREFIX.pack(MAGIC, len(text)), text, *parts))


def decode(message: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return what :func:`encode` was given.

    Raises:
        ValueError: The bytes are no such message.
    """
    if len(message) < _PREFIX.size:
        raise ValueError(f"{len(message)} bytes are too few for a frame message")
    magic, length = _PREFIX.unpack_from(message)
    if magic != MAGIC:
        raise ValueError(f"a frame message begins with {MAGIC!r}, got {magic!r}")
    body = _PREFIX.size + length
    meta = json.loads(message[_PREFIX.size : body])
    arrays = {
        name: np.frombuffer(
            message, np.dtype(f"<{kind}"), int(np.prod(shape, dtype=np.int64)), body + offset
        ).reshape(shape)
        for name, kind, shape, offset in meta.pop("arrays")
    }
    return meta, arrays
