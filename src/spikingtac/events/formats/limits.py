"""Limits of what is read: sizes that a file states are accepted up to a limit only."""

from __future__ import annotations

import bz2
import io
import os
from typing import Any

from spikingtac.errors import ConfigError, FormatError, MissingExtraError

# Largest piece of an input (a chunk, a message, an array) that is taken into memory, MiB: an hour
# of tracks stays below, and a piece costs at most thrice as much while it is decoded (ours).
PIECE_LIMIT_MIB = 128

LIMIT_VARIABLE = "SPIKINGTAC_PIECE_LIMIT_MIB"  # Environment variable that raises the limit.

SIDE_LIMIT_PX = 1 << 16  # Columns and rows that a coordinate of two bytes can name.

# Largest sensor that is believed, px: 16 megapixels; a map of it takes 64 MB (the largest event
# sensor on the market has one).
AREA_LIMIT_PX = 1 << 24


def piece_limit_bytes() -> int:
    """Return the largest piece of an input that is taken into memory, bytes.

    Raises:
        ConfigError: The environment names a limit that is no positive number.
    """
    text = os.environ.get(LIMIT_VARIABLE, str(PIECE_LIMIT_MIB))
    if not (text.isascii() and text.isdigit() and 0 < int(text) < 1 << 40):
        raise ConfigError(f"{LIMIT_VARIABLE} is {text!r}, it must be a whole number of MiB")
    return int(text) << 20


def refuse_piece(what: str, claimed_bytes: int | None = None) -> None:
    """Refuse a piece that is larger than the limit.

    Args:
        what: The piece, for the error.
        claimed_bytes: What it takes; None where that is only known to be too much.

    Raises:
        FormatError: It takes more than the limit.
    """
    limit = piece_limit_bytes()
    if claimed_bytes is not None and claimed_bytes <= limit:
        return
    claim = "takes" if claimed_bytes is None else f"takes {claimed_bytes} bytes,"
    raise FormatError(
        f"{what} {claim} more than the {limit >> 20} MiB that one piece of an input may take; if "
        f"the file is sound, raise the limit: {LIMIT_VARIABLE}=1024"
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
    limit = piece_limit_bytes()
    if kind in ("", "none"):
        content = data
    elif kind in _DECOMPRESSORS:
        try:
            content = _DECOMPRESSORS[kind](data, limit + 1)
        except ImportError as error:
            raise MissingExtraError(f"{kind} needs: pip install 'spikingtac[formats]'") from error
        except (RuntimeError, ValueError, EOFError, MemoryError, OverflowError, OSError) as error:
            raise DamagedPieceError(str(error)) from error
    else:
        raise DamagedPieceError(f"unknown compression {kind!r}")
    if len(content) > limit:
        refuse_piece(where)
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
