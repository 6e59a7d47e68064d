"""The arrays of a file by one schema: types, shapes that belong together, plausible numbers."""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import RecordingError
from spikingtac.events.formats.array_file import load_arrays

# Name of an array -> type of its numbers and its shape: a letter is one length throughout.
Specs = Mapping[str, tuple[type[np.generic], str]]
INCREASING = ("t_us", "marker_t_us", "contact_t_us")  # Names of times that must increase.
LARGEST = float(1 << 53)  # Largest number; times in us up to it are exact as floats.

# Array of truth.npz -> type and shape: n and k times, m markers.
TRUTH_SPECS: Specs = {
    "marker_t_us": (np.int64, "n"),
    "marker_px": (np.float32, "nm2"),
    "reference_px": (np.float32, "m2"),
    "radius_px": (np.float32, "m"),
    "contact_t_us": (np.int64, "k"),
    "in_contact": (np.bool_, "k"),
    "force_n": (np.float64, "k3"),
    "torque_n_mm": (np.float64, "k3"),
}
TRUE_MARKERS = ("marker_t_us", "marker_px")
AGAIN = "render the recording again with: spikingtac simulate SCENE -o FOLDER"


def load_truth(path: Path, needed: Collection[str] = TRUE_MARKERS) -> dict[str, NDArray[Any]]:
    """Return the arrays of a ``truth.npz``.

    Args:
        path: The file.
        needed: The arrays that must be there.

    Raises:
        RecordingError: It cannot be read, lacks an array, or holds one of another kind.
    """
    found = load_arrays(path, "ground truth")
    try:
        require_shapes(found, TRUTH_SPECS, needed)
    except KeyError as error:
        raise RecordingError(f"{str(path)!r} holds no {error.args[0]}; {AGAIN}") from error
    except ValueError as error:
        raise RecordingError(f"{str(path)!r}: {error}; {AGAIN}") from error
    return found


def require_shapes(
    values: Mapping[str, NDArray[Any]], specs: Specs, needed: Collection[str]
) -> None:
    """Refuse arrays that do not belong together; those that the specs do not name are let in.

    Raises:
        ValueError: A shape or a type does not fit, a number is not finite or beyond
            :data:`LARGEST`, or times do not increase.
        KeyError: An array is missing.
    """
    lengths = {"2": 2, "3": 3}
    for name, (dtype, letters) in specs.items():
        if name not in values and name not in needed:
            continue
        array = values[name]
        for letter, length in zip(letters, array.shape, strict=False):
            lengths.setdefault(letter, length)
        shape = tuple(lengths.get(letter, 0) for letter in letters)
        if array.shape != shape or array.dtype.kind != np.dtype(dtype).kind:
            raise ValueError(
                f"{name} is {array.dtype} of shape {array.shape}, it must be "
                f"{np.dtype(dtype)} of shape {shape}"
            )
        if not ((array >= -LARGEST) & (array <= LARGEST)).all():  # no comparison holds for NaN
            raise ValueError(f"{name} holds a number that is not finite, or beyond {LARGEST:g}")
        if name in INCREASING and not (np.diff(array) > 0).all():
            raise ValueError(f"{name} does not increase")
