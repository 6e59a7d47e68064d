"""Limits of what is read: sizes that a file states are accepted up to a limit only."""

from __future__ import annotations

import bz2
import io
from typing import Any

from spikingtac.errors import FormatError, MissingExtraError

# Largest piece of an input (a chunk, a message, an array) that is taken into memory, bytes: an hour
# of tracks stays below, and a piece costs at most thrice as much while it is decoded.
PIECE_LIMIT_BYTES = 128 << 20

SIDE_LIMIT_PX = 1 << 16  # Columns and rows that a coordinate of two bytes can name.

# Largest sensor that is believed, px: 16 megapixels; a map of it takes 64 MB (the largest event
# sensor on the market has one).
AREA_LIMIT_PX = 1 << 24


def refuse_piece(what: str, claimed_bytes: int) -> None:
    """Refuse a piece that is larger than the limit.

    Args:
        what: The piece, for the error.
        claimed_bytes: What it takes.

    Raises:
        FormatError: It takes more than the limit.
    """
    if claimed_bytes > PIECE_LIMIT_BYTES:
        raise FormatError(
            f"{what} takes {claimed_bytes} bytes, more than the {PIECE_LIMIT_BYTES >> 20} MiB that "
            "one piece of an input may take; if the file is sound, write it again in smaller pieces"
        )


def require_size(size: tuple[int, int], where: str) -> tuple[int, int]:
    """Return a sensor's size.

    Args:
        size: ``(width, height)``, px.
        where: Its origin, for the error.

    Raises:
        FormatError: No sensor has such a size.
    """
    width, height = size
    if min(size) < 1 or max(size) > SIDE_LIMIT_PX or width * height > AREA_LIMIT_PX:
        raise FormatError(
            f"{where}: a sensor of {width}x{height} px is not possible (valid: 1 to "
            f"{SIDE_LIMIT_PX} a side, {AREA_LIMIT_PX} px together); give the true size with size="
        )
    return size


class DamagedPieceError(ValueError):
    """The compressed bytes are damaged; readers count it and go on."""


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
    elif kind in _DECOMPRESSORS:
        try:
            content = _DECOMPRESSORS[kind](data, PIECE_LIMIT_BYTES + 1)
        except ImportError as error:
            raise MissingExtraError(f"{kind} needs: pip install 'spikingtac[formats]'") from error
        except (RuntimeError, ValueError, EOFError, MemoryError, OverflowError, OSError) as error:
            raise DamagedPieceError(str(error)) from error
    else:
        raise DamagedPieceError(f"unknown compression {kind!r}")
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


def _bz2(data: bytes, limit: int) -> bytes:
    return _streamed(bz2.BZ2Decompressor(), data, limit)


_DECOMPRESSORS = {"lz4": _lz4, "zstd": _zstd, "bz2": _bz2}
