"""What a page does with a frame message: the inverse of ``encode``."""

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
    """Return what ``encode`` was given."""
    magic, length = PREFIX.unpack_from(message)
    assert magic == MAGIC
    body = PREFIX.size + length
    meta = json.loads(message[PREFIX.size : body])
    arrays = {
        name: np.frombuffer(message, f"<{kind}", int(np.prod(shape)), body + offset).reshape(shape)
        for name, kind, shape, offset in meta.pop("arrays")
    }
    return meta, arrays
