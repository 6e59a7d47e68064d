"""The JSON of a calibration: one table of what its keys hold, for reading and writing."""

import base64
import reprlib
import zlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError, nearest

CALIBRATION_SCHEMA = 1

LARGEST_AREA_PX = 1 << 24  # Largest sensor, px: 16 megapixels, of which a map takes 64 MB.

MARKERS, ANY = -1, -2  # Lengths that stand for the number of markers, and for any number.


@dataclass(frozen=True, slots=True)
class Numbers:
    """What a key holds.

    Attributes:
        what: In words.
        low: Least of its numbers.
        high: Largest of them.
        shape: How many there are along each axis; none for a single one.
        kind: What they are: float, int or bool.
        decimals: To so many they are written.
    """

    what: str
    low: float
    high: float
    shape: tuple[int, ...] = ()
    kind: type = float
    decimals: int = 6

    def read(self, name: str, value: Any, markers: int) -> Any:
        """Return the number or the numbers of parsed JSON; true, false and texts are none.

        Raises:
            ValueError: It holds something else; says what was given and what is valid.
        """
        shape = tuple(markers if length == MARKERS else length for length in self.shape)
        found = np.array(value)
        if ANY in shape:
            found = found if found.size else found.reshape(0, *shape[1:])
            shape = (len(found), *shape[1:])
        fits = found.dtype.kind in ("b" if self.kind is bool else "iuf") and found.shape == shape
        fits = fits and bool(((found >= self.low) & (found <= self.high)).all())
        if not fits or not (found.astype(self.kind) == found).all():
            size = f" of shape {found.shape}" if found.size > 4 else ""
            raise ValueError(
                f"{name} is {reprlib.repr(value)}{size}, it must hold {self.what.format(markers)}, "
                f"{self.low:g} to {self.high:g}"
            )
        numbers = found.astype(self.kind)
        return numbers if shape else numbers.item()

    def written(self, value: Any) -> Any:
        """Return numbers as JSON has them."""
        return np.round(np.asarray(value, np.float64), self.decimals).astype(self.kind).tolist()

    def of_each_marker(self) -> "Numbers":
        """Return the same for a list with a number for each marker."""
        what = f"{self.what}, for each of {{}} markers"
        return replace(self, what=what, shape=(MARKERS,), decimals=5)


# What an event stands for: a thousandth of a usual step, and the full swing.
STEP = Numbers("the share of a full swing of an event", 1e-4, 1.0)

# Above one, and the dynamic range of a camera, 80 dB.
CONTRAST = Numbers("the larger of marker and ground over the other", 1.0001, 1e4)

EDGE = Numbers("the scale of a marker's edge, px", 1e-3, 100.0)  # Beyond it nothing is an edge.

# Numbers of the sensor that each marker may have of its own: ``marker_`` and the name.
OWN = {"step_on": STEP, "step_off": STEP, "contrast": CONTRAST, "edge_px": EDGE}

MARKER_NUMBERS = {f"marker_{name}": one.of_each_marker() for name, one in OWN.items()}

MEASURED = "marker_measured"

NUMBERS = {
    "size": Numbers("width and height of the sensor, px", 1, LARGEST_AREA_PX, (2,), int),
    "grid": Numbers("two whole numbers, rows and columns", 1, LARGEST_AREA_PX, (2,), int),
    "reference_px": Numbers(
        "x and y of each of {} markers, px", -1e6, 1e6, (MARKERS, 2), decimals=4
    ),
    "radius_px": Numbers("the radii of {} markers, px", 1e-3, 1e5, (MARKERS,), decimals=4),
    **OWN,
    # Photoreceptors in the dark and USB together take less than 0.1 s.
    "lag_us": Numbers("a delay, us", 0.0, 1e5),
    "dead_time_us": Numbers("a dead time, us", 0.0, 1e4),
    # From a pixel for 100 mm to 0.1 um a pixel.
    "px_per_mm": Numbers("the pixels of a millimetre of skin", 1e-2, 1e4),
    "recovery_s": Numbers("a time, s", 1e-3, 100.0),
    **MARKER_NUMBERS,
    MEASURED: Numbers("true or false for each of {} markers", 0, 1, (MARKERS,), bool),
    "hot_px": Numbers("the column and the row of each hot pixel", 0, 1e6, (ANY, 2), int),
}

LARGEST_RADIAL = 0.9  # Beyond 1 the model folds the image over itself inside of the sensor.

# Keys of a lens; in px and mm it holds nothing that is larger than a million.
LENS = {
    "center_px": Numbers("x and y of the centre, px", -1e6, 1e6, (2,)),
    "half_diagonal_px": Numbers("half of the diagonal, px", 1e-3, 1e6),
    "radial": Numbers("the radial coefficient", -LARGEST_RADIAL, LARGEST_RADIAL),
    "radial_sigma": Numbers("the standard error of the radial coefficient", 0.0, 1e6),
    "homography": Numbers("a homography of 3x3", -1e6, 1e6, (3, 3)),
    "residual_mm": Numbers("a residual, mm", 0.0, 1e6),
}

MAPS = ("step_on_map", "step_off_map")  # Keys that may be absent: packed maps.

# One count of a packed map stands for 0.0001 of the full swing: a thousandth of a usual step.
COUNTS_PER_UNIT = 10_000

# Keys of files of version 0.1, whose steps have another meaning.
FORMER_KEYS = ("band_scale_on", "band_scale_off")

KEYS = ("schema", *NUMBERS, *MAPS, "polarity", "hysteresis", "lens", "provenance")

# What errors of a file advise.
NEEDS = (
    "; a calibration needs schema 1, size [w, h], grid [rows, cols] or null, "
    "reference_px [[x, y], ...] row-major and radius_px [...]"
)


def checked_document(document: Any, where: str, advice: str = NEEDS) -> dict[str, Any]:
    """Return the arguments of ``Calibration`` from parsed JSON.

    Args:
        document: What the JSON held; lists or arrays.
        where: Its origin, for errors.
        advice: End of errors.

    Raises:
        CalibrationError: A key is missing or unfit; names it and what a calibration needs.
    """
    try:
        return _checked(document)
    except KeyError as error:
        what = f"the key {error} is missing"
    except (TypeError, ValueError, OverflowError, AttributeError) as error:
        what = str(error)
    raise CalibrationError(f"{where}: {what}{advice}")


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
    found = _numbers(document)
    size = found["size"]
    return {
        **found,
        **{name: unpack_map(document[name], size, name) for name in MAPS if document.get(name)},
        "polarity": polarity,
        "hysteresis": document.get("hysteresis"),
        "lens": None if document.get("lens") is None else checked_lens(document["lens"]),
        "provenance": document.get("provenance") or {},
    }


def checked_lens(document: Any) -> dict[str, Any]:
    """Return the arguments of ``Lens`` from parsed JSON.

    Raises:
        KeyError: A key is missing.
        TypeError: It is no object.
        ValueError: A value is unfit.
    """
    found = {name: kind.read(f"lens: {name}", document[name], 0) for name, kind in LENS.items()}
    if np.linalg.det(found["homography"]) == 0.0:
        raise ValueError("lens has a homography that cannot be inverted")
    return found | {"center_px": tuple(found["center_px"].tolist())}


def _numbers(document: dict[str, Any]) -> dict[str, Any]:
    """Return all numbers.

    Raises:
        ValueError: Some are unfit, or a marker lies wholly off the sensor or is larger than it, two
            share one pixel, or a hot pixel lies off the sensor.
    """
    given: dict[str, Any] = {name: document.get(name) for name in NUMBERS}
    given |= {name: document[name] for name in ("size", "grid", "reference_px", "radius_px")}
    markers = len(given["reference_px"])
    if given["grid"] is not None:
        markers = int(NUMBERS["grid"].read("grid", given["grid"], markers).prod())
    found: dict[str, Any] = {"grid": None}
    for name, numbers in NUMBERS.items():
        value = given[name]
        if name == "radius_px" and np.ndim(value) == 0:
            value = [value] * markers
        if value is not None:
            found[name] = numbers.read(name, value, markers)
    found |= {name: tuple(found[name].tolist()) for name in ("size", "grid") if given[name]}
    (width, height), reference_px = found["size"], found["reference_px"]
    radius_px = found["radius_px"]
    if width * height > LARGEST_AREA_PX:
        raise ValueError(f"a sensor of {width}x{height} px is not possible")
    if radius_px.max() > max(width, height):
        raise ValueError(f"a radius of {radius_px.max():g} px is larger than the sensor")
    reach_px = radius_px[:, np.newaxis]
    inside_px = reference_px.clip(-reach_px, np.array(found["size"]) + reach_px)
    off = (inside_px != reference_px).any(axis=1)
    if off.any():
        raise ValueError(
            f"marker {np.argmax(off)} at {reference_px[np.argmax(off)].tolist()} px lies off the "
            f"sensor of {width}x{height} px"
        )
    first = np.unique(np.round(reference_px), axis=0, return_index=True)[1]
    for place in np.delete(reference_px, first, axis=0).tolist():
        raise ValueError(f"two markers lie at one and the same pixel, {place}; leave out one")
    if (found.get("hot_px", np.zeros((0, 2))) >= (width, height)).any():
        raise ValueError(f"hot_px holds a pixel off the sensor of {width}x{height} px")
    return found


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
