"""The JSON of a calibration, checked key by key before it becomes a value."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.lens import Lens
from spikingtac.calibration.step_maps import unpack_map
from spikingtac.errors import CalibrationError

CALIBRATION_SCHEMA = 1
LARGEST_AREA_PX = 1 << 24
"""Largest sensor that is believed, px: 16 megapixels, of which a map takes 64 MB."""
BAND_SCALES = ("band_scale_on", "band_scale_off")
"""Keys that may be absent, both or none."""
OPTIONAL_NUMBERS = (
    "step_on",
    "step_off",
    "contrast",
    "edge_px",
    "lag_us",
    "px_per_mm",
    "recovery_s",
    *BAND_SCALES,
)
"""Keys that may be absent; finite and not negative where present."""
OPTIONAL_MARKER_NUMBERS = (
    "marker_contrast",
    "marker_edge_px",
    "marker_step_on",
    "marker_step_off",
)
"""Keys that may be absent: one positive number for each marker."""
MEASURED = "marker_measured"
"""Key that may be absent: one true or false for each marker."""
HOT_PIXELS = "hot_px"
"""Key that may be absent: column and row of each hot pixel."""
OPTIONAL_MAPS = ("step_on_map", "step_off_map")
"""Keys that may be absent; packed maps (:mod:`spikingtac.calibration.step_maps`)."""


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
        f"{where}: {what}; a calibration needs schema 1, size [w, h], grid [rows, cols], "
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
    grid, size = _pair(document["grid"]), _size(document["size"])
    return {
        "size": size,
        "grid": grid,
        **_markers(document, grid[0] * grid[1], size),
        **_numbers(document),
        **_marker_values(document, grid[0] * grid[1]),
        **_maps(document, size),
        HOT_PIXELS: _pixels(document.get(HOT_PIXELS), size),
        "polarity": polarity,
        "hysteresis": document.get("hysteresis"),
        "lens": None if document.get("lens") is None else Lens.from_document(document["lens"]),
        "provenance": dict(document.get("provenance") or {}),
    }


def _markers(
    document: dict[str, Any], markers: int, size: tuple[int, int]
) -> dict[str, NDArray[np.float64]]:
    reference = np.array(document["reference_px"], np.float64)
    radius = np.array(document["radius_px"], np.float64)
    if reference.shape != (markers, 2):
        raise ValueError(f"the grid asks for {markers} points, got shape {reference.shape}")
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


def _numbers(document: dict[str, Any]) -> dict[str, float]:
    given = {name: document.get(name) for name in OPTIONAL_NUMBERS}
    numbers = {name: float(value) for name, value in given.items() if value is not None}
    for name, value in numbers.items():
        if not (np.isfinite(value) and value >= 0):
            raise ValueError(f"{name} is {value}, it must be finite and not negative")
    scales = [numbers.get(name) for name in BAND_SCALES]
    if scales != [None, None] and not all(scales):
        raise ValueError(f"{' and '.join(BAND_SCALES)} must both be positive, or both be absent")
    return numbers


def _marker_values(document: dict[str, Any], markers: int) -> dict[str, NDArray[Any]]:
    values: dict[str, NDArray[Any]] = {}
    for name in (*OPTIONAL_MARKER_NUMBERS, MEASURED):
        given = document.get(name)
        if given is None:
            continue
        value = np.array(given)
        if value.shape != (markers,):
            raise ValueError(f"{name} has shape {value.shape}, expected ({markers},)")
        if name == MEASURED:
            if value.dtype != np.bool_:
                raise ValueError(f"{name} must hold true or false for each marker")
        else:
            value = value.astype(np.float64)
            if not (np.isfinite(value).all() and (value > 0).all()):
                raise ValueError(f"{name} must be finite and positive")
        values[name] = value
    return values


def _maps(document: dict[str, Any], size: tuple[int, int]) -> dict[str, NDArray[np.float32]]:
    given = {name: document.get(name) for name in OPTIONAL_MAPS}
    return {name: unpack_map(text, size, name) for name, text in given.items() if text is not None}


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


def _size(value: Any) -> tuple[int, int]:
    width, height = _pair(value)
    if width * height > LARGEST_AREA_PX:
        raise ValueError(f"a sensor of {width}x{height} px is not possible")
    return width, height


def _pair(value: Any) -> tuple[int, int]:
    first, second = (int(item) for item in value)
    if first < 1 or second < 1:
        raise ValueError(f"{[first, second]} must be positive")
    return first, second
