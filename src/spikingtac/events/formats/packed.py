"""Recordings inside gzip or zip: unpacked into a temporary file, up to a limit, and read there."""

from __future__ import annotations

import gzip
import os
import shutil
import tempfile
import weakref
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import IO

from spikingtac.errors import FormatError, RecordingError
from spikingtac.events.formats.array_file import ARCHIVE_DAMAGE, PACKINGS
from spikingtac.events.formats.file_source import FileSource
from spikingtac.events.formats.limits import piece_limit_bytes

# Largest content that is unpacked, in pieces of an input: 4 GiB unless the environment raises it
# (:mod:`spikingtac.events.formats.limits`).
LIMIT_PIECES = 32

# Most that content beyond one piece may be compressed; events gain 2 to 10 (ours).
BOMB_RATIO = 100

COPY_BYTES = 1 << 12  # Bytes unpacked at once: what a damaged archive loses of its sound part.


def open_packed(path: Path, opener: Callable[[Path], FileSource]) -> FileSource:
    """Return the source of the recording inside an archive.

    Args:
        path: A ``.gz`` of one file, or a ``.zip`` that holds one file.
        opener: Opens the unpacked file.

    Raises:
        FormatError: The archive cannot be read, holds several files, or unpacks beyond the limit.
    """
    folder = Path(tempfile.mkdtemp(prefix="spikingtac-"))
    try:
        inner, damage = _unpacked(path, folder)
        try:
            source = opener(inner)
        except RecordingError as error:
            told = str(error).replace(str(inner), f"{path} ({inner.name})")
            raise type(error)(told) from error
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
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
    except (*ARCHIVE_DAMAGE, zlib.error) as error:
        raise FormatError(f"{str(path)!r} cannot be unpacked: {error}") from error


def _copied(
    content: IO[bytes] | gzip.GzipFile, inner: Path, packed: int, path: Path
) -> tuple[Path, str]:
    """Copy content up to the limits; return the file, and what ended it early."""
    limit, written = LIMIT_PIECES * piece_limit_bytes(), 0
    with inner.open("wb") as file:
        while True:
            try:
                data = content.read(COPY_BYTES)
            except (OSError, EOFError, ValueError, zlib.error, zipfile.BadZipFile) as error:
                if not written:
                    raise
                return inner, str(error)
            if not data:
                return inner, ""
            written += len(data)
            bomb = written > piece_limit_bytes() and written > BOMB_RATIO * packed
            if written > limit or bomb:
                raise FormatError(
                    f"{str(path)!r} unpacks to more than {written >> 20} MiB from "
                    f"{os.path.getsize(path)} bytes; unpack it yourself if that is meant, or raise "
                    "the limit: SPIKINGTAC_PIECE_LIMIT_MIB=1024"
                )
            file.write(data)
