"""The JSON of a calibration: one schema, with the plausible range of every field."""

from __future__ import annotations

import base64
import binascii
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.lens import Lens
from spikingtac.errors import CalibrationError

CALIBRATION_SCHEMA = 1

LARGEST_AREA_PX = 1 << 24  # Largest sensor, px: 16 megapixels, of which a map takes 64 MB.

# Range of what an event stands for: a thousandth of a usual step, and the full swing.
STEP = (1e-4, 1.0)

# Range of marker over ground intensity: above one, and the dynamic range of a camera, 80 dB.
CONTRAST = (1.0001, 1e4)

EDGE_PX = (1e-3, 100.0)  # Range of a marker's blur: beyond it nothing is an edge.

# Numbers that may be absent, and their ranges.
NUMBERS = {
    "step_on": STEP,
    "step_off": STEP,
    "contrast": CONTRAST,
    "edge_px": EDGE_PX,
    "lag_us": (0.0, 1e5),  # photoreceptors in the dark and USB together take less than 0.1 s
    "px_per_mm": (1e-2, 1e4),  # from a pixel for 100 mm to 0.1 um a pixel
    "recovery_s": (1e-3, 100.0),
}

# Lists with a number for each marker that may be absent, and their ranges.
MARKER_NUMBERS = {
    "marker_contrast": CONTRAST,
    "marker_edge_px": EDGE_PX,
    "marker_step_on": STEP,
    "marker_step_off": STEP,
}

MEASURED = "marker_measured"  # Key that may be absent: one true or false for each marker.

HOT_PIXELS = "hot_px"  # Key that may be absent: column and row of each hot pixel.

MAPS = ("step_on_map", "step_off_map")  # Keys that may be absent: packed maps.

# One count of a packed map stands for 0.0001 of the full swing: a thousandth of a usual step.
COUNTS_PER_UNIT = 10_000

# Files of version 0.1 hold one byte per pixel, and one count stands for 0.001.
FORMER_COUNTS_PER_UNIT = 1000

# Keys of earlier files: factors from the steps that they hold to the measured ones.
FORMER_SCALES = {
    "band_scale_on": ("step_on", "marker_step_on", "step_on_map"),
    "band_scale_off": ("step_off", "marker_step_off", "step_off_map"),
}

FORMER_SCALE = (1e-2, 100.0)  # Range of these factors.


def checked_document(document: Any, where: str) -> dict[str, Any]:
    """Return the arguments of ``Calibration`` from parsed JSON.

    Args:
        document: What the JSON held.
        where: Its origin, for errors.

    Raises:
        CalibrationError: A key is missing or unfit; names it and what a calibration needs.
    """
    try:
        return _checked(document)
    except KeyError as error:
        what = f"the key {error} is missing"
    except (TypeError, ValueError, OverflowError, AttributeError) as error:
        what = str(error)
    raise CalibrationError(
        f"{where}: {what}; a calibration needs schema 1, size [w, h], grid [rows, cols] or null, "
        "reference_px [[x, y], ...] row-major and radius_px [...]"
    )


def _checked(document: Any) -> dict[str, Any]:
    if not isinstance(document, dict):
        raise ValueError("the document is not a JSON object")
    if document.get("schema") != CALIBRATION_SCHEMA:
        raise ValueError(f"schema is {document.get('schema')!r}, this version reads 1")
    polarity = document.get("polarity", "white")
    if polarity not in ("white", "dark"):
        raise ValueError(f"polarity is {polarity!r}, valid are 'white' and 'dark'")
    size = _whole_pair(document["size"], "size")
    if size[0] * size[1] > LARGEST_AREA_PX:
        raise ValueError(f"a sensor of {size[0]}x{size[1]} px is not possible")
    grid = None if document["grid"] is None else _whole_pair(document["grid"], "grid")
    markers = _markers(document, grid, size)
    values = _numbers(document, NUMBERS) | _marker_values(document, len(markers["radius_px"]))
    values |= {name: unpack_map(document[name], size, name) for name in MAPS if document.get(name)}
    return {
        "size": size,
        "grid": grid,
        **markers,
        **_steps_as_measured(document, values),
        HOT_PIXELS: _pixels(document.get(HOT_PIXELS), size),
        "polarity": polarity,
        "hysteresis": document.get("hysteresis"),
        "lens": None if document.get("lens") is None else Lens.from_document(document["lens"]),
        "provenance": dict(document.get("provenance") or {}),
    }


def _whole_pair(value: Any, name: str) -> tuple[int, int]:
    first, second = (int(item) for item in value)
    if [first, second] != list(value) or min(first, second) < 1:
        raise ValueError(f"{name} is {value}, it must hold two whole numbers that must be positive")
    return first, second


def _markers(
    document: dict[str, Any], grid: tuple[int, int] | None, size: tuple[int, int]
) -> dict[str, NDArray[np.float64]]:
    reference = np.array(document["reference_px"], np.float64)
    radius = np.array(document["radius_px"], np.float64)
    markers = len(reference) if grid is None else grid[0] * grid[1]
    if reference.shape != (markers, 2) or not markers:
        raise ValueError(f"the grid asks for {markers or 'some'} points, got {reference.shape}")
    if radius.ndim == 0:
        radius = np.full(markers, float(radius))
    if radius.shape != (markers,):
        raise ValueError(f"radius_px has shape {radius.shape}, expected ({markers},)")
    if not (np.isfinite(reference).all() and np.isfinite(radius).all() and (radius > 0).all()):
        raise ValueError("positions must be finite and radii positive")
    _require_places(reference, radius, size)
    return {"reference_px": reference, "radius_px": radius}


def _require_places(
    reference_px: NDArray[np.float64], radius_px: NDArray[np.float64], size: tuple[int, int]
) -> None:
    """Refuse markers that no sensor could show.

    Raises:
        ValueError: A marker lies wholly off the sensor, is larger than it, or two share one pixel.
    """
    if radius_px.max() > max(size):
        raise ValueError(f"a radius of {radius_px.max():g} px is larger than the sensor")
    off = (reference_px < -radius_px[:, None]) | (
        reference_px > np.array(size) + radius_px[:, None]
    )
    if off.any():
        marker = int(np.argmax(off.any(axis=1)))
        raise ValueError(
            f"marker {marker} at {reference_px[marker].tolist()} px lies off the sensor of "
            f"{size[0]}x{size[1]} px"
        )
    _, place, times = np.unique(
        np.round(reference_px), axis=0, return_inverse=True, return_counts=True
    )
    if times.max() > 1:
        pair = np.flatnonzero(place.ravel() == int(np.argmax(times)))[:2].tolist()
        raise ValueError(f"markers {pair[0]} and {pair[1]} lie at one and the same pixel")


def _numbers(document: dict[str, Any], ranges: dict[str, tuple[float, float]]) -> dict[str, float]:
    numbers = {}
    for name, (low, high) in ranges.items():
        if document.get(name) is not None:
            numbers[name] = float(document[name])
            if not low <= numbers[name] <= high:
                raise ValueError(f"{name} is {document[name]}, it must lie in {low:g} to {high:g}")
    return numbers


def _steps_as_measured(document: dict[str, Any], values: dict[str, Any]) -> dict[str, Any]:
    scales = _numbers(document, dict.fromkeys(FORMER_SCALES, FORMER_SCALE))
    scaled = {
        name: np.minimum(values[name] * scale, STEP[1])
        for key, scale in scales.items()
        for name in FORMER_SCALES[key]
        if name in values
    }
    return values | scaled


def _marker_values(document: dict[str, Any], markers: int) -> dict[str, NDArray[Any]]:
    values: dict[str, NDArray[Any]] = {}
    for name in (*MARKER_NUMBERS, MEASURED):
        if document.get(name) is None:
            continue
        value = np.array(document[name])
        if value.shape != (markers,):
            raise ValueError(f"{name} has shape {value.shape}, expected ({markers},)")
        if name == MEASURED:
            if value.dtype != np.bool_:
                raise ValueError(f"{name} must hold true or false for each marker")
        else:
            value, (low, high) = value.astype(np.float64), MARKER_NUMBERS[name]
            if not ((value >= low) & (value <= high)).all():
                raise ValueError(f"{name} must be positive, each from {low:g} to {high:g}")
        values[name] = value
    return values


def _pixels(value: Any, size: tuple[int, int]) -> NDArray[np.int64] | None:
    if value is None:
        return None
    pixels = np.array(value)
    if not pixels.size:
        return np.empty((0, 2), np.int64)
    if pixels.dtype.kind != "i" or pixels.shape[1:] != (2,):
        raise ValueError(f"{HOT_PIXELS} must hold the column and the row of each hot pixel")
    if not ((pixels >= 0) & (pixels < size)).all():
        raise ValueError(f"{HOT_PIXELS} holds a pixel off the sensor of {size[0]}x{size[1]} px")
    return pixels.astype(np.int64)


def pack_map(values: NDArray[np.floating]) -> str:
    """Return a map of steps as text: two bytes per pixel, deflated, in base64.

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
    """Return the map ``(height, width)`` that a text holds.

    Args:
        text: What the JSON held under ``name``.
        size: ``(width, height)`` of the sensor, px.
        name: The key, for errors.

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
    return steps.reshape(height, width).clip(0.0, 1.0)
