"""MP4 video for talks and papers.

The video is AV1, free of royalties. Pillow, which is installed anyway, writes animations as AVIF,
by libavif and libaom, both under BSD licences. Such a file is an MP4 file in all but its names
(ISO/IEC 14496-12, and the AV1 and AVIF specifications of the Alliance for Open Media): the pictures
are a track of AV1 samples. Here it gets the names of a video, and its still picture is taken out.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from spikingtac.errors import MissingExtraError

if TYPE_CHECKING:
    from PIL.Image import Image

# Of 100, and of 10: thin lines stay sharp, and a picture of 442 px takes some milliseconds.
QUALITY, SPEED = 80, 8

# What a video says it is: the base format with its features up to edition 6, AV1, MP4.
BRANDS = (b"iso6", b"av01", b"mp41")

# Type of a track of moving pictures; where it stands in a box ``hdlr``, after its head.
VIDEO, HANDLER_AT = b"vide", 8
CONTAINERS = (b"moov", b"trak", b"mdia")
HEAD = 8  # Bytes of a box before its content: length and type.

# Box -> bytes between its flags and its duration in version 0, where dates have 4 bytes.
BEFORE_DURATION = {b"mvhd": 12, b"tkhd": 16, b"mdhd": 12}


def write_mp4(pictures: Sequence[Image], frame_ms: int, path: Path) -> None:
    """Write pictures as a video.

    Args:
        pictures: One or more, of one size.
        frame_ms: Time between two, ms.
        path: File to write.

    Raises:
        MissingExtraError: The installed Pillow has no AVIF.
    """
    from PIL import features

    if not features.check("avif"):
        raise MissingExtraError(
            "MP4 needs a Pillow with AVIF, as its wheels have it from 11.3 on; install it with: "
            "pip install --upgrade --force-reinstall pillow; or export to .gif"
        )
    first, *rest = pictures
    animation = io.BytesIO()
    first.save(
        animation, "AVIF", save_all=True, append_images=rest or [first], duration=frame_ms,
        quality=QUALITY, speed=SPEED,
    )  # fmt: skip
    path.write_bytes(_as_video(animation.getvalue()))


def _as_video(animation: bytes) -> bytes:
    """Return an AVIF animation as an MP4 video; every byte keeps its place.

    Args:
        animation: File of at least two pictures, as libavif writes it.
    """
    video = bytearray(animation)
    boxes = list(_boxes(video, 0, len(video)))
    # Box -> format and place of its duration.
    durations: dict[bytes, tuple[str, int]] = {}
    for kind, at, end in boxes:
        if kind == b"ftyp":
            brands = (end - at - 8) // 4  # after the major brand and its version
            names = [BRANDS[number % len(BRANDS)] for number in range(brands)]
            video[at:end] = BRANDS[0] + bytes(4) + b"".join(names)
        elif kind == b"hdlr":
            video[at + HANDLER_AT : at + HANDLER_AT + 4] = VIDEO
        elif kind in (b"meta", b"edts"):  # the still picture; the order to play without end
            video[at - 4 : at] = b"free"
        elif kind in BEFORE_DURATION:
            wide = video[at] == 1  # version 1: dates and duration of 8 bytes
            place = at + (12 if wide else 4) + BEFORE_DURATION[kind]
            durations[kind] = (">Q" if wide else ">I"), place
    # The length of the media stands behind that of the film and the track, which never end.
    length, place = durations.pop(b"mdhd")
    (duration,) = struct.unpack_from(length, video, place)
    for length, place in durations.values():
        struct.pack_into(length, video, place, duration)
    return bytes(video)


def _boxes(file: bytearray, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield type, begin and end of the content of each box, and of those within containers."""
    while start + HEAD <= end:
        length, kind = struct.unpack_from(">I4s", file, start)
        stop = start + length if length else end  # the last box may go to the end of the file
        yield kind, start + HEAD, stop
        if kind in CONTAINERS:
            yield from _boxes(file, start + HEAD, stop)
        start = stop
