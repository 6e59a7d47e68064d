"""NumPy's archives: read without trust, written column by column at constant memory.

One schema says which arrays a file holds: types, shapes that belong together, plausible numbers.
"""

import math
import shutil
import tempfile
import zipfile
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import replacing
from spikingtac.errors import RecordingError
from spikingtac.events.formats.pieces import PACKINGS, refuse_piece
from spikingtac.file_kinds import ARCHIVE_DAMAGE

# Most that arrays beyond the limit may be compressed: stored ones take what their file takes.
BOMB_RATIO = 20

# The earliest date that ZIP knows: archives must not depend on the clock.
_EPOCH = (1980, 1, 1, 0, 0, 0)

_COPY_BYTES = 1 << 20


def load_arrays(
    path: str | Path, what: str, only: Collection[str] | None = None
) -> dict[str, NDArray[Any]]:
    """Return the arrays of an ``.npz``.

    Args:
        path: The file.
        what: What it should hold, for the error.
        only: The arrays to read, all of which must be there; None reads every one.

    Raises:
        RecordingError: The file is missing, damaged, or no archive of plain arrays; FormatError
            where an array inflates beyond the limit of a piece.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            names = [name for name in archive.namelist() if name.endswith(".npy")]
            if only is not None:
                names = [f"{name}.npy" for name in only]
            return {name.removesuffix(".npy"): _array(archive, name, path) for name in names}
    except ARCHIVE_DAMAGE as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise RecordingError(f"{str(path)!r} cannot be read as {what}: {reason}") from error


def read_array_header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return shape, whether by columns, and type of the array whose ``.npy`` begins here.

    Raises:
        ValueError: It is damaged, or holds Python objects.
    """
    form = np.lib.format
    first = form.read_magic(file) == (1, 0)
    header = (form.read_array_header_1_0 if first else form.read_array_header_2_0)(file)
    if header[2].hasobject:
        raise ValueError("it holds Python objects, which are not loaded")
    return header


def open_member(archive: zipfile.ZipFile, name: str) -> IO[bytes]:
    """Open an array of an archive; raises what damaged archives raise."""
    if archive.getinfo(name).compress_type not in PACKINGS:
        raise ValueError(f"{name} is packed by another method than NumPy's")
    return archive.open(name)


def _array(archive: zipfile.ZipFile, name: str, path: str | Path) -> NDArray[Any]:
    info = archive.getinfo(name)
    with open_member(archive, name) as member:
        shape, fortran_order, dtype = read_array_header(member)
        size = math.prod(shape) * dtype.itemsize
        if size > info.file_size:
            raise ValueError(f"{name} claims {dtype} of shape {shape}")
        if size > BOMB_RATIO * info.compress_size:
            refuse_piece(f"{str(path)!r}: {name}", size)
        data = bytearray(member.read(size))
        if len(data) < size:
            raise EOFError(f"{name} ends early")
        if member.read(1):  # also checks the checksum
            raise ValueError(f"{name} holds more than it says")
    return np.ndarray(shape, dtype, data, order="F" if fortran_order else "C")


class ColumnFile:
    """An ``.npz`` whose columns grow; the same values give the same bytes.

    Args:
        path: File to write; replaced if it exists.
    """

    def __init__(self, path: str | Path) -> None:
        self._path, self._closed = Path(path), False
        self._spools: dict[str, tuple[IO[bytes], np.dtype[Any], list[int]]] = {}
        self._fixed: dict[str, NDArray[Any]] = {}

    def append(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Append rows to the named columns (the first call sets their types and row shapes)."""
        for name, values in columns.items():
            if name not in self._spools:
                spool = tempfile.TemporaryFile()  # noqa: SIM115
                self._spools[name] = (spool, values.dtype, [0, *values.shape[1:]])
            spool, dtype, shape = self._spools[name]
            spool.write(np.ascontiguousarray(values, dtype).tobytes())
            shape[0] += len(values)

    def set(self, name: str, values: NDArray[Any]) -> None:
        """Set a member that does not grow."""
        self._fixed[name] = np.asarray(values, order="C")

    def close(self) -> None:
        """Write the archive; further calls do nothing."""
        if not self._closed:
            try:
                with replacing(self._path) as partial, zipfile.ZipFile(partial, "w") as archive:
                    self._write(archive)
            finally:
                self.abandon()

    def abandon(self) -> None:
        """Write nothing; further calls do nothing."""
        self._closed = True
        for spool, _, _ in self._spools.values():
            spool.close()

    def _write(self, archive: zipfile.ZipFile) -> None:
        for name, (spool, dtype, shape) in self._spools.items():
            spool.seek(0)
            with _begun(archive, name, dtype, tuple(shape)) as member:
                shutil.copyfileobj(spool, member, _COPY_BYTES)
        for name, values in self._fixed.items():
            with _begun(archive, name, values.dtype, values.shape) as member:
                member.write(values.tobytes())


def _begun(
    archive: zipfile.ZipFile, name: str, dtype: np.dtype[Any], shape: tuple[int, ...]
) -> IO[bytes]:
    """Return an array of an archive, behind its header."""
    info = zipfile.ZipInfo(f"{name}.npy", date_time=_EPOCH)
    info.create_system = 3  # Unix, on every system
    info.external_attr = 0o600 << 16
    member = archive.open(info, "w", force_zip64=True)
    header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(member, header)
    return member


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
