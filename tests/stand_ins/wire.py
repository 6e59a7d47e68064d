"""What a page does with a frame message: the inverse of ``encode``."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.viewer.snapshot import MAGIC, PREFIX


def unpack(packed: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return ``(height, width)`` codes of an image, of which two share a byte."""
    flat = np.stack([packed >> 4, packed & 15], axis=1).ravel()
    return flat[: size[0] * size[1]].reshape(size[1], size[0])


def decode(message: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return what ``encode`` was given.

    Raises:
        ValueError: The bytes are no such message.
    """
    if len(message) < PREFIX.size:
        raise ValueError(f"{len(message)} bytes are too few for a frame message")
    magic, length = PREFIX.unpack_from(message)
    if magic != MAGIC:
        raise ValueError(f"a frame message begins with {MAGIC!r}, got {magic!r}")
    body = PREFIX.size + length
    meta = json.loads(message[PREFIX.size : body])
    arrays = {
        name: np.frombuffer(
            message, np.dtype(f"<{kind}"), int(np.prod(shape, dtype=np.int64)), body + offset
        ).reshape(shape)
        for name, kind, shape, offset in meta.pop("arrays")
    }
    return meta, arrays
