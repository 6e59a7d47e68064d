"""NumPy archives: written column by column at constant memory, read without trust."""

from __future__ import annotations

import math
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Collection, Mapping
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import replacing
from spikingtac.errors import RecordingError
from spikingtac.events.formats.limits import piece_limit_bytes, refuse_piece

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


def _array(archive: zipfile.ZipFile, name: str, path: str | Path) -> NDArray[Any]:
    info = archive.getinfo(name)
    if info.compress_type not in PACKINGS:
        raise ValueError(f"{name} is packed by another method than NumPy's")
    with archive.open(name) as member:
        version = np.lib.format.read_magic(member)
        header = np.lib.format
        read = header.read_array_header_1_0 if version == (1, 0) else header.read_array_header_2_0
        shape, fortran_order, dtype = read(member)
        size = math.prod(shape) * dtype.itemsize
        if dtype.hasobject or size > info.file_size:
            raise ValueError(f"{name} claims {dtype} of shape {shape}")
        if size > piece_limit_bytes() and size > BOMB_RATIO * info.compress_size:
            refuse_piece(f"{str(path)!r}: {name}", size)
        data = bytearray(size)
        view = memoryview(data)
        for first in range(0, size, _COPY_BYTES):
            piece = view[first : first + _COPY_BYTES]
            read = member.read(len(piece))
            if len(read) < len(piece):
                raise EOFError(f"{name} ends early")
            piece[:] = read
        if member.read(1):  # also checks the checksum
            raise ValueError(f"{name} holds more than it says")
    return np.ndarray(shape, dtype, data, order="F" if fortran_order else "C")


class ColumnFile:
    """An ``.npz`` whose columns grow; the same values give the same bytes.

    Args:
        path: File to write; replaced if it exists.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self._spools: dict[str, tuple[IO[bytes], np.dtype[Any], list[int]]] = {}
        self._fixed: dict[str, NDArray[Any]] = {}
        self._closed = False

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
        if self._closed:
            return
        self._closed = True
        try:
            with replacing(self._path) as partial:
                self._write(partial)
        finally:
            self._close_spools()

    def abandon(self) -> None:
        """Write nothing; further calls do nothing."""
        self._closed = True
        self._close_spools()

    def _close_spools(self) -> None:
        for spool, _, _ in self._spools.values():
            spool.close()

    def _write(self, path: Path) -> None:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
            for name, (spool, dtype, shape) in self._spools.items():
                with archive.open(_member(name), "w", force_zip64=True) as member:
                    spool.seek(0)
                    _write_header(member, dtype, tuple(shape))
                    while data := spool.read(_COPY_BYTES):
                        member.write(data)
            for name, values in self._fixed.items():
                with archive.open(_member(name), "w", force_zip64=True) as member:
                    _write_header(member, values.dtype, values.shape)
                    member.write(values.tobytes())


def _member(name: str) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(f"{name}.npy", date_time=_EPOCH)
    info.create_system = 3  # Unix, on every system
    info.external_attr = 0o600 << 16
    return info


def _write_header(member: IO[bytes], dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
    description = np.lib.format.dtype_to_descr(dtype)
    np.lib.format.write_array_header_1_0(
        member, {"descr": description, "fortran_order": False, "shape": shape}
    )
