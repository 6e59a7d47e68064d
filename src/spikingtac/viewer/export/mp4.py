"""A tracked stretch as an MP4 video, for talks and papers: AV1, free of royalties.

Pillow, which is installed anyway, writes animations as AVIF, by libavif and libaom, both under BSD
licences. Such a file is an MP4 file in all but its names (ISO/IEC 14496-12, and the AV1 and AVIF
specifications of the Alliance for Open Media): the pictures are a track of AV1 samples. Here it
gets the names of a video, and its still picture is taken out.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from pathlib import Path

from spikingtac.errors import MissingExtraError
from spikingtac.viewer.export.stretch import draw_stretch
from spikingtac.viewer.source import ViewSource

FRAME_MS = 40  # Twenty-five frames per second, as in film and television of half the world.
MOST_COLORS = 256

# Of 100, and of 10: thin lines stay sharp, and a picture of 442 px takes some milliseconds.
QUALITY, SPEED = 80, 8

# What a video says it is: the base format with its features up to edition 6, AV1, MP4.
BRANDS = (b"iso6", b"av01", b"mp41")

# Type of a track of moving pictures; where it stands in a box ``hdlr``, after its head.
VIDEO, HANDLER_AT = b"vide", 8
CONTAINERS = (b"moov", b"trak", b"mdia")
HEAD = 8  # Bytes of a box before its content: length and type.


def export_mp4(view: ViewSource, path: str | Path, *, seconds: float | None = None) -> int:
    """Track a view and write what a page would show; return the number of pictures.

    Args:
        view: From :func:`spikingtac.viewer.opening.open_view_source`.
        path: File to write.
        seconds: Length of the stretch from its beginning; None is all of it, a minute at most.

    Raises:
        ConfigError: The source does not end and no length was given, or nothing was tracked.
        MissingExtraError: The installed Pillow has no AVIF.
    """
    from PIL import features

    if not features.check("avif"):
        raise MissingExtraError(
            "MP4 needs a Pillow with AVIF, as its wheels have it from 11.3 on; install it with: "
            "pip install --upgrade --force-reinstall pillow; or export to .gif"
        )
    first, *rest = pictures = draw_stretch(view, FRAME_MS, MOST_COLORS, seconds)
    animation = io.BytesIO()
    first.save(
        animation, "AVIF", save_all=True, append_images=rest or [first], duration=FRAME_MS,
        quality=QUALITY, speed=SPEED,
    )  # fmt: skip
    Path(path).write_bytes(as_video(animation.getvalue()))
    return len(pictures)


def as_video(animation: bytes) -> bytes:
    """Return an AVIF animation as an MP4 video; every byte keeps its place.

    Args:
        animation: File of at least two pictures, as libavif writes it.
    """
    video = bytearray(animation)
    duration = 0
    # The length of the media stands behind that of the film and the track, which never end.
    for kind, at, _ in _boxes(video, 0, len(video)):
        if kind == b"mdhd":
            (duration,) = struct.unpack_from(*_duration(video, at, 12))
    for kind, at, end in _boxes(video, 0, len(video)):
        if kind == b"ftyp":
            brands = (end - at - 8) // 4  # after the major brand and its version
            names = [BRANDS[number % len(BRANDS)] for number in range(brands)]
            video[at:end] = BRANDS[0] + bytes(4) + b"".join(names)
        elif kind == b"hdlr":
            video[at + HANDLER_AT : at + HANDLER_AT + 4] = VIDEO
        elif kind in (b"meta", b"edts"):  # the still picture; the order to play without end
            video[at - 4 : at] = b"free"
        elif kind in (b"mvhd", b"tkhd"):
            struct.pack_into(*_duration(video, at, 12 if kind == b"mvhd" else 16), duration)
    return bytes(video)


def _boxes(file: bytearray, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield type, begin and end of the content of each box, and of those within containers."""
    while start + HEAD <= end:
        (length,), kind = struct.unpack_from(">I", file, start), bytes(file[start + 4 : start + 8])
        stop = start + length if length else end  # the last box may go to the end of the file
        yield kind, start + HEAD, stop
        if kind in CONTAINERS:
            yield from _boxes(file, start + HEAD, stop)
        start = stop


def _duration(file: bytearray, at: int, before: int) -> tuple[str, bytearray, int]:
    """Return format, file and place of a duration.

    Args:
        file: The file.
        at: Begin of the content of ``mvhd``, ``tkhd`` or ``mdhd``: version, flags, two dates ...
        before: Bytes between the flags and the duration in version 0; dates have 4 bytes there.
    """
    wide = file[at] == 1  # version 1: dates and duration of 8 bytes
    return (">Q", file, at + 12 + before) if wide else (">I", file, at + 4 + before)
