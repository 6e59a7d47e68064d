"""Decompress pieces of files without trusting what they claim."""

from __future__ import annotations

import bz2
import io

from spikingtac.errors import MissingExtraError
from spikingtac.events.formats.checks.limits import piece_limit_bytes, refuse_piece


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
    elif kind == "lz4":
        content = _lz4(data, limit + 1)
    elif kind == "zstd":
        content = _zstd(data, limit + 1)
    elif kind == "bz2":
        content = _bz2(data, limit + 1)
    else:
        raise DamagedPieceError(f"unknown compression {kind!r}")
    if len(content) > limit:
        refuse_piece(where)
    return content


def _lz4(data: bytes, limit: int) -> bytes:
    try:
        from lz4.frame import LZ4FrameDecompressor
    except ImportError as error:
        raise MissingExtraError("LZ4 needs: pip install 'spikingtac[formats]'") from error
    decoder = LZ4FrameDecompressor()
    try:
        content = decoder.decompress(data, limit)
    except (RuntimeError, ValueError, EOFError, MemoryError, OverflowError) as error:
        raise DamagedPieceError(str(error)) from error
    if not decoder.eof and len(content) < limit:
        raise DamagedPieceError("it ends early")
    return content


def _zstd(data: bytes, limit: int) -> bytes:
    try:
        import zstandard
    except ImportError as error:
        raise MissingExtraError("Zstandard needs: pip install 'spikingtac[formats]'") from error
    content, left = [], limit
    try:
        decoder = zstandard.ZstdDecompressor(max_window_size=1 << 27)
        with decoder.stream_reader(io.BytesIO(data), read_across_frames=True) as reader:
            while left and (piece := reader.read(min(left, 1 << 20))):
                content.append(piece)
                left -= len(piece)
    except (zstandard.ZstdError, ValueError, MemoryError) as error:
        raise DamagedPieceError(str(error)) from error
    return b"".join(content)


def _bz2(data: bytes, limit: int) -> bytes:
    decoder = bz2.BZ2Decompressor()
    try:
        content = decoder.decompress(data, limit)
    except (OSError, ValueError, EOFError) as error:
        raise DamagedPieceError(str(error)) from error
    if not decoder.eof and len(content) < limit:
        raise DamagedPieceError("it ends early")
    return content
