"""Array types that many modules use, and how objects that hold arrays are printed."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]  # Array of float64 of any shape.

# Longer arrays are printed by type and shape, longer values are cut.
MOST_NUMBERS, MOST_LETTERS = 6, 60


def one_line(self: Any) -> str:
    """Return a dataclass in one line, as its ``__repr__``; what is None is left out."""
    shown = [
        f"{field.name}={_short(value)}"
        for field in dataclasses.fields(self)
        if field.repr and (value := getattr(self, field.name)) is not None
    ]
    return f"{type(self).__name__}({', '.join(shown)})"


def _short(value: Any) -> str:
    if isinstance(value, np.ndarray) and value.size > MOST_NUMBERS:
        return f"<{value.dtype} {value.shape}>"
    text = " ".join(repr(value).split())
    return text if len(text) <= MOST_LETTERS else f"{text[:MOST_LETTERS]}..."
