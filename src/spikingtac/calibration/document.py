"""The JSON of a calibration: one schema, with the plausible range of every field."""

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.lens import Lens
from spikingtac.errors import CalibrationError, nearest

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

# Keys of files of version 0.1, whose steps have another meaning.
FORMER_KEYS = ("band_scale_on", "band_scale_off")

KEYS = (
    *("schema", "size", "grid", "reference_px", "radius_px", "polarity"),
    *(*NUMBERS, *MARKER_NUMBERS, MEASURED, HOT_PIXELS, *MAPS),
    *("hysteresis", "lens", "provenance"),
)


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
    for key in document:
        if key in FORMER_KEYS and document[key] is not None:
            raise ValueError(f"{key} is a key of version 0.1; calibrate the sensor again")
        if key not in (*KEYS, *FORMER_KEYS):
            raise ValueError(f"unknown key {key!r}{nearest(key, KEYS)} (valid: {', '.join(KEYS)})")
    polarity = document.get("polarity", "white")
    if polarity not in ("white", "dark"):
        raise ValueError(f"polarity is {polarity!r}, valid are 'white' and 'dark'")
    for name, kind, what in (("hysteresis", str, "a name"), ("provenance", dict, "an object")):
        if not isinstance(document.get(name), kind | None):
            raise ValueError(f"{name} is {document[name]!r}, it must be {what}")
    size = _whole_pair(document["size"], "size")
    if size[0] * size[1] > LARGEST_AREA_PX:
        raise ValueError(f"a sensor of {size[0]}x{size[1]} px is not possible")
    grid = None if document["grid"] is None else _whole_pair(document["grid"], "grid")
    reference_px, radius_px = _markers(document, grid, size)
    return {
        "size": size,
        "grid": grid,
        "reference_px": reference_px,
        "radius_px": radius_px,
        **_numbers(document, len(radius_px)),
        MEASURED: _measured(document.get(MEASURED), len(radius_px)),
        **{name: unpack_map(document[name], size, name) for name in MAPS if document.get(name)},
        HOT_PIXELS: _pixels(document.get(HOT_PIXELS), size),
        "polarity": polarity,
        "hysteresis": document.get("hysteresis"),
        "lens": None if document.get("lens") is None else Lens.from_document(document["lens"]),
        "provenance": document.get("provenance") or {},
    }


def _whole_pair(value: Any, name: str) -> tuple[int, int]:
    first, second = (int(item) for item in value)
    if [first, second] != list(value) or min(first, second) < 1:
        raise ValueError(f"{name} is {value}, it must hold two whole numbers that must be positive")
    return first, second


def _markers(
    document: dict[str, Any], grid: tuple[int, int] | None, size: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return rest positions and radii.

    Raises:
        ValueError: They do not fit the grid, or a marker lies wholly off the sensor, is larger than
            it, or two share one pixel.
    """
    reference = _real(document["reference_px"], "reference_px")
    radius = _real(document["radius_px"], "radius_px")
    markers = len(reference) if grid is None else grid[0] * grid[1]
    if reference.shape != (markers, 2) or not markers:
        raise ValueError(f"the grid asks for {markers or 'some'} points, got {reference.shape}")
    if radius.ndim == 0:
        radius = np.full(markers, float(radius))
    if radius.shape != (markers,):
        raise ValueError(f"radius_px has shape {radius.shape}, expected ({markers},)")
    if not (np.isfinite(reference).all() and np.isfinite(radius).all() and (radius > 0).all()):
        raise ValueError("positions must be finite and radii positive")
    if radius.max() > max(size):
        raise ValueError(f"a radius of {radius.max():g} px is larger than the sensor")
    reach = radius[:, np.newaxis]
    off = ((reference < -reach) | (reference > np.array(size) + reach)).any(axis=1)
    if off.any():
        raise ValueError(
            f"marker {np.argmax(off)} at {reference[np.argmax(off)].tolist()} px lies off the "
            f"sensor of {size[0]}x{size[1]} px"
        )
    if len(np.unique(np.round(reference), axis=0)) < markers:
        raise ValueError("two markers lie at one and the same pixel")
    return reference, radius


def _real(value: Any, name: str) -> NDArray[np.float64]:
    """Return numbers; true, false and texts are none."""
    found = np.array(value)
    if found.dtype.kind not in "iuf":
        raise ValueError(f"{name} is {value!r}, it must hold numbers")
    return found.astype(np.float64)


def _numbers(document: dict[str, Any], markers: int) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name, (low, high) in (NUMBERS | MARKER_NUMBERS).items():
        if document.get(name) is None:
            continue
        value, shape = _real(document[name], name), () if name in NUMBERS else (markers,)
        if value.shape != shape:
            raise ValueError(f"{name} has shape {value.shape}, expected {shape}")
        if not ((value >= low) & (value <= high)).all():
            raise ValueError(f"{name} is {value}, it must lie in {low:g} to {high:g}")
        values[name] = value if shape else float(value)
    return values


def _measured(value: Any, markers: int) -> NDArray[np.bool_] | None:
    if value is None:
        return None
    measured = np.array(value)
    if measured.shape != (markers,) or measured.dtype != np.bool_:
        raise ValueError(f"{MEASURED} must hold true or false for each marker")
    return measured


def _pixels(value: Any, size: tuple[int, int]) -> NDArray[np.int64] | None:
    if value is None:
        return None
    pixels = np.array(value) if len(value) else np.empty((0, 2), np.int64)
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
    inflater = zlib.decompressobj()
    try:
        # One byte more than fits shows what is too long without inflating all of it.
        counts = inflater.decompress(base64.b64decode(text, validate=True), 2 * width * height + 1)
    except (TypeError, ValueError, zlib.error) as error:
        raise ValueError(f"{name} is no deflated map in base64: {error}; leave it out") from error
    if len(counts) != 2 * width * height or not inflater.eof:
        raise ValueError(
            f"{name} holds another number of bytes than two for each of the {width * height} "
            f"pixels of {width}x{height}; leave it out"
        )
    steps = np.frombuffer(counts, "<u2").astype(np.float32) / np.float32(COUNTS_PER_UNIT)
    return steps.reshape(height, width).clip(0.0, 1.0)
