"""What a page does with a frame message: the inverse of ``encode``."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.viewer.web.wire import _PREFIX, MAGIC


def decode(message: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return what ``encode`` was given.

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
