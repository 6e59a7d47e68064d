"""Events in the video frames of a Raspberry Pi's kernel driver, from the device or from a dump.

Source: Prophesee, ``rpi-sensor-drivers``. The sensor's words fill frames of a fixed size, 4096 x
391 bytes; each frame's words end at a mark, behind which stands what an earlier frame left. The
device is read by ``v4l2-ctl`` (v4l-utils), as the maker shows it; a dump that it has written with
``--stream-to`` is read as a file.
"""

from __future__ import annotations

import contextlib
import os
import select
import shutil
import stat
import subprocess
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from spikingtac.cameras.words import WORD_OPTIONS, BareWords
from spikingtac.errors import CameraLostError, ConfigError, DeviceError
from spikingtac.events.address import Address
from spikingtac.events.cameras.camera import Camera
from spikingtac.events.formats.evt.words import Rows

FRAME = (4096, 391)
"""Width and height of a frame, bytes."""
TOOL = "v4l2-ctl"
LOOK_BYTES = 1 << 14
"""Stretch of a frame in which its mark is looked for at once: 4 ms of EVT2 words at 1 Mev/s."""
PIPE_BYTES = 1 << 20
"""Room that is asked for in the tool's pipe, what Linux grants to anybody: two reads a frame."""
_MARKS = {"evt2": ("<u4", 0xF00000FF, 0xE0000019), "evt3": ("<u2", 0xFFFF, 0xE019)}
"""Type of the words in which a mark is looked for, the bits that count, and their value."""
_MARK_IN_HEADS = (0xF0000FFF, 0xE0000019)
"""The same for the upper halves of EVT2.1 words."""


class V4l2Camera(Camera):
    """Frames of a video device, or of a file with such frames one after another."""

    OPTIONS: ClassVar[tuple[str, ...]] = (*WORD_OPTIONS, "frame")
    checked = True

    def __init__(self, address: Address, file: int, tool: subprocess.Popen[bytes] | None) -> None:
        super().__init__()
        self._words = BareWords(address, self.losses, self.triggers, encoding="evt21")
        self.size = self._words.size
        width, height = address.size("frame") or FRAME
        self._frame_bytes = width * height
        # Frames are read in place: a copy of 1.6 MB takes as long as the decoding of its words.
        self._frame, self._filled = memoryview(bytearray(self._frame_bytes)), 0
        self._order = address.text("order", "little")
        self._file: int | None = file
        self._tool = tool
        self._ended = False

    @classmethod
    def open(cls, address: Address) -> Self:
        """Start the device, or open the dump; see :meth:`Camera.open`."""
        if not address.target:
            raise ConfigError("v4l2: needs a device or a dump, as v4l2:/dev/video0")
        path = Path(address.target)
        if not path.exists():
            raise DeviceError(
                f"there is no {address.target!r}; load the sensor's driver (sudo dtoverlay "
                "genx320), or name the file of a dump"
            )
        if not stat.S_ISCHR(path.stat().st_mode):
            return cls(address, os.open(path, os.O_RDONLY), None)
        tool = _streaming(path)
        assert tool.stdout is not None
        return cls(address, tool.stdout.fileno(), tool)

    def read(self, timeout_s: float) -> Rows | None:
        """Return the events of the next frame; see :meth:`Camera.read`."""
        if self._file is None or self._ended:
            return None
        while self._filled < self._frame_bytes:
            if not select.select([self._file], [], [], timeout_s)[0]:
                return self.nothing()
            got = os.readv(self._file, [self._frame[self._filled :]])
            if not got:
                return self._end()
            self._filled += got
        self._filled = 0
        return self._words.feed(self._payload(self._frame))

    def close(self) -> None:
        """Stop the device, or close the file."""
        file, self._file = self._file, None
        if self._tool is not None:
            self._tool.terminate()
            self._tool.communicate()
            self._tool = None
        elif file is not None:
            os.close(file)

    def describe(self) -> dict[str, Any]:
        """Return the encoding, and the frame's bytes."""
        return {"frame_bytes": self._frame_bytes, **self._words.describe()}

    def _end(self) -> Rows | None:
        self._ended = True
        if self._tool is not None:
            raise CameraLostError(f"{TOOL} has ended: the device is gone, or refuses to stream")
        self.losses.add("truncated", int(self._filled > 0))
        rows = self._words.feed(self._payload(self._frame[: self._filled]), final=True)
        return rows if len(rows[3]) else None

    def _payload(self, frame: memoryview) -> memoryview:
        """Return the words of a frame before its mark; all of them where there is none."""
        end = self._mark(frame)
        if end is None:
            self.losses.add("no_end_mark", int(len(frame) > 0))
            return frame[: len(frame) // self._words.word_bytes * self._words.word_bytes]
        return frame[:end]

    def _mark(self, frame: memoryview) -> int | None:
        """Return the offset of the mark, bytes; a frame is looked through up to its mark only."""
        if self._words.encoding == "evt21":
            kind = ">u4" if self._order == "big" else "<u4"
            first, stride = (1 if self._order == "little" else 0), 2
            bits, value = _MARK_IN_HEADS
        else:
            (kind, bits, value), first, stride = _MARKS[self._words.encoding], 0, 1
        size = self._words.word_bytes
        whole = len(frame) // size * size
        mask = np.array(bits, kind)
        for start in range(0, whole, LOOK_BYTES):
            words = np.frombuffer(frame[start : min(start + LOOK_BYTES, whole)], kind)
            found = (words[first::stride] & mask) == value
            place = int(found.argmax())
            if found[place]:
                return start + place * size
        return None


def _streaming(path: Path) -> subprocess.Popen[bytes]:
    """Start the tool that writes the device's frames to its standard output."""
    tool = shutil.which(TOOL)
    if tool is None:
        raise DeviceError(f"{TOOL} is not installed; get it with: sudo apt install v4l-utils")
    command = [tool, "--device", str(path), "--stream-mmap", "--stream-count=0", "--stream-to=-"]
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    assert process.stdout is not None
    with contextlib.suppress(ImportError, AttributeError, OSError):  # without it, more reads
        import fcntl

        fcntl.fcntl(process.stdout, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
    return process
