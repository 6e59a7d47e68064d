"""Maps of per-pixel steps as short text: two bytes per pixel, deflated, in base64."""

from __future__ import annotations

import base64
import binascii
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

COUNTS_PER_UNIT = 10_000
"""One count stands for 0.0001 of the full swing: a thousandth of a typical step."""

FORMER_COUNTS_PER_UNIT = 1000
"""Files of version 0.1 hold one byte per pixel, and one count stands for 0.001."""


def pack_map(values: NDArray[np.floating]) -> str:
    """Return a map as text.

    Args:
        values: ``(height, width)`` shares of the full swing, 0 to 1; 0 stands for "no value of its
            own".

    Example:
        >>> import numpy as np
        >>> steps = np.full((2, 3), 0.139, np.float32)
        >>> bool(np.allclose(unpack_map(pack_map(steps), (3, 2), "step_on_map"), steps))
        True
    """
    counts = np.clip(np.rint(np.asarray(values) * COUNTS_PER_UNIT), 0, COUNTS_PER_UNIT)
    return base64.b64encode(zlib.compress(counts.astype("<u2").tobytes(), 9)).decode("ascii")


def unpack_map(text: Any, size: tuple[int, int], name: str) -> NDArray[np.float32]:
    """Return the map that a text holds.

    Args:
        text: What the JSON held under ``name``.
        size: ``(width, height)`` of the sensor, px.
        name: The key, for errors.

    Returns:
        ``(height, width)`` float32.

    Raises:
        ValueError: The text is no base64, does not inflate, or holds another number of pixels.
    """
    width, height = size
    if not isinstance(text, str):
        raise ValueError(f"{name} must be base64 text, got {type(text).__name__}")
    try:
        packed = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        raise ValueError(f"{name} is no base64: {error}; leave the key out") from error
    inflater = zlib.decompressobj()
    try:
        # One byte more than fits shows what is too long without inflating all of it.
        counts = inflater.decompress(packed, 2 * width * height + 1)
    except zlib.error as error:
        raise ValueError(f"{name} does not inflate: {error}; leave the key out") from error
    whole = inflater.eof
    if whole and len(counts) == 2 * width * height:
        steps = np.frombuffer(counts, "<u2").astype(np.float32) / np.float32(COUNTS_PER_UNIT)
    elif whole and len(counts) == width * height:
        steps = np.frombuffer(counts, np.uint8) / np.float32(FORMER_COUNTS_PER_UNIT)
    else:
        found = f"{len(counts)} bytes" if whole else f"more than {2 * width * height} bytes"
        raise ValueError(
            f"{name} holds {found} where the size {width}x{height} asks for two bytes for each of "
            f"its {width * height} pixels; leave the key out"
        )
    return steps.reshape(height, width)
