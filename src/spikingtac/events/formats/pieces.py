"""Files made of pieces that tell their length: a damaged piece costs only itself.

AEDAT4, MCAP and ROS 1 bags are such files. What a piece claims is believed up to a limit only.
"""

import bz2
import io
import re
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO, NamedTuple

from spikingtac.errors import FormatError, MissingExtraError

# Largest piece of an input (a chunk, a message, an array) that is taken into memory, bytes: an hour
# of tracks stays below, and a piece costs at most thrice as much while it is decoded.
PIECE_LIMIT_BYTES = 128 << 20

# Bytes that are searched at once for the next piece after damage, and the longest mark of one.
SEARCH_BYTES, MARK_BYTES = 1 << 20, 32
CUT = -1  # Kind of the rest of a file in which no further piece is found.

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
    if kind in ("", "none"):
        content = data
    elif kind not in _DECOMPRESSORS:
        raise DamagedPieceError(f"unknown compression {kind!r}")
    else:
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

    content, left = [], limit
    decoder = zstandard.ZstdDecompressor(max_window_size=1 << 27)
    try:
        with decoder.stream_reader(io.BytesIO(data), read_across_frames=True) as reader:
            while left and (piece := reader.read(min(left, 1 << 20))):
                content.append(piece)
                left -= len(piece)
    except zstandard.ZstdError as error:
        raise DamagedPieceError(str(error)) from error
    return b"".join(content)


_DECOMPRESSORS: dict[str, Callable[[bytes, int], bytes]] = {
    "lz4": _lz4,
    "zstd": _zstd,
    "bz2": lambda data, limit: _streamed(bz2.BZ2Decompressor(), data, limit),
}
