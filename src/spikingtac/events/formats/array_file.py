"""Archives: NumPy's, and those that a recording was packed into; read without trust.

NumPy archives are written column by column at constant memory.
"""

import codecs
import gzip
import math
import shutil
import struct
import tempfile
import weakref
import zipfile
import zlib
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import replacing
from spikingtac.errors import FormatError, RecordingError
from spikingtac.events.formats.file_source import FileSource
from spikingtac.events.formats.pieces import PIECE_LIMIT_BYTES, refuse_piece

UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)  # How a text in UTF-16 begins.

# What zipfile and NumPy's header parser raise on damaged archives.
ARCHIVE_DAMAGE = (
    OSError, EOFError, ValueError, zipfile.BadZipFile, zlib.error, NotImplementedError,
    SyntaxError, TokenError, RuntimeError, MemoryError, OverflowError, TypeError,
    KeyError, struct.error,
)  # fmt: skip

# What NumPy writes; Python unpacks others without a bound on what comes out.
PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)

# Most that arrays beyond the limit may be compressed: stored ones take what their file takes.
BOMB_RATIO = 20

# Largest content of an archive that is unpacked, bytes.
CONTENT_LIMIT_BYTES = 1 << 32

# Most that content beyond one piece may be compressed; events gain 2 to 10.
PACKED_RATIO = 100

UNPACKED_BYTES = 1 << 12  # Bytes unpacked at once: what a damaged archive loses of its sound part.

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


def open_packed(path: Path, opener: Callable[[Path], FileSource]) -> FileSource:
    """Return the source of the recording inside an archive.

    Args:
        path: A ``.gz`` of one file, a ``.zip`` that holds one file, or a text in UTF-16.
        opener: Opens the unpacked file.

    Raises:
        FormatError: The archive cannot be read, holds several files, or unpacks beyond the limit.
    """
    folder = Path(tempfile.mkdtemp(prefix="spikingtac-"))
    try:
        inner, damage = _unpacked(path, folder)
        source = opener(inner)
    except BaseException as error:
        shutil.rmtree(folder, ignore_errors=True)
        if isinstance(error, RecordingError):
            raise type(error)(str(error).replace(str(folder), str(path))) from error
        raise
    weakref.finalize(source, shutil.rmtree, folder, ignore_errors=True)
    source.notes.append(f"unpacked from {path.name}")
    if damage:
        source.notes.append(f"{path.name} is damaged and was unpacked up to there: {damage}")
        source.lost_before = {"truncated": 1}
    return source


def _unpacked(path: Path, folder: Path) -> tuple[Path, str]:
    """Return the unpacked file, and what ended it early."""
    packed = path.stat().st_size
    try:
        with path.open("rb") as file:
            if file.read(2) in UTF16_MARKS:
                file.seek(0)
                recoded: Any = codecs.EncodedFile(file, "utf-8", "utf-16")
                return _copied(recoded, folder / path.name, packed, path)
        if not zipfile.is_zipfile(path):
            inner = folder / (path.stem if path.suffix.lower() in (".gz", ".gzip") else path.name)
            with gzip.open(path) as content:
                return _copied(content, inner, packed, path)
        with zipfile.ZipFile(path) as archive:
            files = [info for info in archive.infolist() if not info.is_dir()]
            files = [info for info in files if not info.filename.startswith("__MACOSX/")]
            if len(files) != 1 or files[0].compress_type not in PACKINGS:
                names = ", ".join(info.filename for info in files[:5]) or "nothing"
                raise FormatError(
                    f"{str(path)!r} holds {names}; a zip with exactly one recording is read: "
                    "unpack it and name a file"
                )
            with archive.open(files[0]) as content:
                inner = folder / (Path(files[0].filename).name or "recording")
                return _copied(content, inner, packed, path)
    except ARCHIVE_DAMAGE as error:
        raise FormatError(f"{str(path)!r} cannot be unpacked: {error}") from error


def _copied(
    content: IO[bytes] | gzip.GzipFile, inner: Path, packed: int, path: Path
) -> tuple[Path, str]:
    """Copy content up to the limits; return the file, and what ended it early."""
    written = 0
    with inner.open("wb") as file:
        while True:
            try:
                data = content.read(UNPACKED_BYTES)
            except (OSError, EOFError, ValueError, zlib.error, zipfile.BadZipFile) as error:
                if not written:
                    raise
                return inner, str(error)
            if not data:
                return inner, ""
            written += len(data)
            if written > min(CONTENT_LIMIT_BYTES, max(PACKED_RATIO * packed, PIECE_LIMIT_BYTES)):
                raise FormatError(
                    f"{str(path)!r} unpacks to more than {written >> 20} MiB from {packed} bytes; "
                    "unpack it yourself if that is meant"
                )
            file.write(data)
