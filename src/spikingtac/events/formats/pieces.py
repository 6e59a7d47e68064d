"""Packed content, read without trust: what it claims is believed up to a limit only.

AEDAT4, MCAP and ROS 1 bags are made of pieces that tell their length: a damaged piece costs only
itself. Any recording may come in an archive, or as a text in UTF-16.
"""

import bz2
import codecs
import gzip
import io
import re
import shutil
import tempfile
import weakref
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, BinaryIO, NamedTuple

from spikingtac.errors import FormatError, MissingExtraError, RecordingError
from spikingtac.events.formats.file_source import FileSource
from spikingtac.file_kinds import ARCHIVE_DAMAGE

# Largest piece of an input (a chunk, a message, an array) that is taken into memory, bytes: an hour
# of tracks stays below, and a piece costs at most thrice as much while it is decoded.
PIECE_LIMIT_BYTES = 128 << 20

# Bytes that are searched at once for the next piece after damage, and the longest mark of one.
SEARCH_BYTES, MARK_BYTES = 1 << 20, 32
ZSTD = b"\x28\xb5\x2f\xfd"  # How compressed content begins.
CUT = -1  # Kind of the rest of a file in which no further piece is found.

UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)  # How a text in UTF-16 begins.

# Endings of what is no recording and no slip of the pen.
FOREIGN = (
    ".pdf", ".png", ".jpg", ".gif", ".svg", ".mp4", ".avi", ".json", ".toml", ".html", ".md",
    ".mat", ".bz2", ".xz", ".zst", ".zstd", ".tar", ".7z", ".rar", ".pkl", ".pickle", ".xlsx",
)  # fmt: skip
DOCUMENTS = ("readme", "readme.txt", "license", "license.txt")  # Names of files beside recordings.

# What NumPy writes; Python unpacks others without a bound on what comes out.
PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)

# Largest content of an archive that is unpacked, bytes.
CONTENT_LIMIT_BYTES = 1 << 32

# Most that content beyond one piece may be compressed; events gain 2 to 10.
PACKED_RATIO = 100

UNPACKED_BYTES = 1 << 12  # Bytes unpacked at once: what a damaged archive loses of its sound part.

Count = Callable[[str], object]  # Counts one more of a kind of damage.
Read = Callable[[int, int], bytes]  # Returns up to so many bytes from a place on.


class Piece(NamedTuple):
    """A piece of a file: its kind, where its content begins and ends, and named fields."""

    kind: int
    start: int
    end: int
    fields: dict[bytes, bytes] = {}  # noqa: RUF012  (never written to)


class Form(NamedTuple):
    """How the pieces of a format are found.

    Attributes:
        mark: Bytes by which a piece may be told, where reading goes on after damage.
        piece_at: Returns the piece that begins at a place before the end, or None.
        proven: Returns where the piece begins to which a mark at a place belongs, or None.
    """

    mark: re.Pattern[bytes]
    piece_at: Callable[[Read, int, int], Piece | None]
    proven: Callable[[Read, int, int], int | None]


def walk(form: Form, read: Read, span: tuple[int, int], count: Count) -> Iterator[Piece]:
    """Yield the pieces of a file in order; after damage, go on where the next one is proven.

    Args:
        form: The format.
        read: Reads the file.
        span: Where the first piece begins, and the length of the file, bytes.
        count: Counts ``bad_record`` where reading goes on, else ``truncated``; then the rest of the
            file is yielded as a piece of the kind :data:`CUT`.
    """
    place, end = span
    while place < end:
        piece = form.piece_at(read, place, end)
        if piece is None:
            marks = (
                first + match.start()
                for first in range(place + 1, end, SEARCH_BYTES)
                for match in form.mark.finditer(read(first, SEARCH_BYTES + MARK_BYTES))
            )
            proven = (form.proven(read, mark, end) for mark in marks)
            found = next((begin for begin in proven if begin is not None), None)
            count("truncated" if found is None else "bad_record")
            if found is not None:
                place = found
                continue
            piece = Piece(CUT, place, end)
        yield piece
        place = piece.end


def reader_of(file: BinaryIO) -> Read:
    """Return what reads a file from any place."""

    def read(place: int, length: int) -> bytes:
        file.seek(place)
        return file.read(length)

    return read


def refuse_piece(what: str, claimed_bytes: int) -> None:
    """Refuse a piece that is larger than the limit.

    Args:
        what: The piece, for the error.
        claimed_bytes: Its length.

    Raises:
        FormatError: It is longer than the limit.
    """
    if claimed_bytes > PIECE_LIMIT_BYTES:
        raise FormatError(
            f"{what} takes {claimed_bytes} bytes, more than the {PIECE_LIMIT_BYTES >> 20} MiB that "
            "one piece of an input may take; if the file is sound, write it again in smaller pieces"
        )


class DamagedPieceError(ValueError):
    """A piece is damaged; readers count it and go on."""


def decompressed(data: bytes, kind: str, where: str) -> bytes:
    """Return the content of a compressed piece.

    Args:
        data: The compressed bytes.
        kind: ``none`` (or nothing), ``lz4``, ``zstd`` or ``bz2``.
        where: The piece, for errors.

    Raises:
        DamagedPieceError: The bytes are damaged, or the kind is unknown.
        FormatError: The content is larger than the limit of a piece.
        MissingExtraError: The library is not installed.
    """
    if kind not in _DECOMPRESSORS:
        raise DamagedPieceError(f"unknown compression {kind!r}")
    try:
        content = _DECOMPRESSORS[kind](data, PIECE_LIMIT_BYTES + 1)
    except ImportError as error:
        raise MissingExtraError(f"{kind} needs: pip install 'spikingtac[formats]'") from error
    except (RuntimeError, ValueError, EOFError, MemoryError, OverflowError, OSError) as error:
        raise DamagedPieceError(str(error)) from error
    refuse_piece(where, len(content))
    return content


def _streamed(decoder: Any, data: bytes, limit: int) -> bytes:
    content = decoder.decompress(data, limit)
    if not decoder.eof and len(content) < limit:
        raise DamagedPieceError("it ends early")
    return content


def _lz4(data: bytes, limit: int) -> bytes:
    from lz4.frame import LZ4FrameDecompressor

    return _streamed(LZ4FrameDecompressor(), data, limit)


def _zstd(data: bytes, limit: int) -> bytes:
    import zstandard

    decoder = zstandard.ZstdDecompressor(max_window_size=1 << 27)
    try:
        with decoder.stream_reader(io.BytesIO(data), read_across_frames=True) as reader:
            return b"".join(reader.read(1 << 20) for _ in range(1 + (limit >> 20)))
    except zstandard.ZstdError as error:
        raise DamagedPieceError(str(error)) from error


_DECOMPRESSORS: dict[str, Callable[[bytes, int], bytes]] = {
    **dict.fromkeys(("", "none"), lambda data, _: data),
    "lz4": _lz4,
    "zstd": _zstd,
    "bz2": lambda data, limit: _streamed(bz2.BZ2Decompressor(), data, limit),
}


def open_packed(path: Path, opener: Callable[[Path], FileSource]) -> FileSource:
    """Return the source of the recording inside an archive.

    Args:
        path: A ``.gz`` of one file, a ``.zip`` with one recording, or a text in UTF-16.
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
            files = [info for info in archive.infolist() if _may_be_recording(info)]
            files = [info for info in files if "event" in Path(info.filename).name.lower()] or files
            if len(files) != 1 or files[0].compress_type not in PACKINGS:
                names = ", ".join(archive.namelist()[:5]) or "nothing"
                raise FormatError(
                    f"{str(path)!r} holds {names}; a zip with exactly one recording, stored or "
                    "deflated, is read: unpack it and name a file"
                )
            with archive.open(files[0]) as content:
                inner = folder / (Path(files[0].filename).name or "recording")
                return _copied(content, inner, packed, path)
    except ARCHIVE_DAMAGE as error:
        raise FormatError(f"{str(path)!r} cannot be unpacked: {error}") from error


def _may_be_recording(info: zipfile.ZipInfo) -> bool:
    """Return whether a member is no folder, no document, and nothing that systems add."""
    member = Path(info.filename)
    added = info.is_dir() or member.name.startswith(".") or "__MACOSX" in member.parts
    return not (added or member.name.lower() in DOCUMENTS or member.suffix.lower() in FOREIGN)


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
