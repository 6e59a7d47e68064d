"""Events in the video frames of a Raspberry Pi's kernel driver, from the device or from a dump.

Source: Prophesee, ``rpi-sensor-drivers``. The sensor's words fill frames of a fixed size, 4096 x
391 bytes; each frame's words end at a mark, behind which stands what an earlier frame left. The
device is read by ``v4l2-ctl`` (v4l-utils), as the maker shows it; a dump that it has written with
``--stream-to`` is read as a file.
"""

import contextlib
import os
import select
import shutil
import stat
import subprocess
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from spikingtac.cameras.words import WORD_OPTIONS, CameraWords, header_of
from spikingtac.errors import CameraLostError, ConfigError, DeviceError
from spikingtac.events.camera import Address, Camera
from spikingtac.events.evt.words import Rows

FRAME = (4096, 391)  # Width and height of a frame, bytes.
TOOL = "v4l2-ctl"

# Most that is read before the mark is looked for: 16 ms of EVT2 words at 1 Mev/s.
READ_BYTES = 1 << 16

# Room that is asked for in the tool's pipe, what Linux grants to anybody: two reads a frame.
PIPE_BYTES = 1 << 20

# The bits that count of the word that marks the end, and their value, by encoding.
_MARKS = {
    "evt2": (0xF00000FF, 0xE0000019),
    "evt21": (0xF0000FFF, 0xE0000019),
    "evt3": (0xFFFF, 0xE019),
}


class V4l2Camera(Camera):
    """Frames of a video device, or of a file with such frames one after another."""

    OPTIONS: ClassVar[tuple[str, ...]] = (*WORD_OPTIONS, "frame")
    checked = True

    def __init__(self, address: Address, file: int, tool: subprocess.Popen[bytes] | None) -> None:
        super().__init__()
        self._words = CameraWords(header_of(address, "evt21"), self.losses, self.triggers)
        self.size = self._words.size
        width, height = address.size("frame") or FRAME
        self._frame_bytes = width * height
        # Of a frame: bytes read, its words as long as no mark came, and whether one did.
        self._at, self._payload, self._marked = 0, bytearray(), False
        self._bits, self._mark_value = _MARKS[self._words.encoding]
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
        """Return the events of the next frame, once its mark is there; see :meth:`Camera.read`."""
        if self._file is None or self._ended:
            return None
        while select.select([self._file], [], [], timeout_s)[0]:
            data = os.read(self._file, min(READ_BYTES, self._frame_bytes - self._at))
            if not data:
                return self._end()
            self._at = (self._at + len(data)) % self._frame_bytes
            words = self._take(data, last=self._at == 0)
            self._marked = self._marked and self._at > 0
            if words is not None:
                return self._words.feed(words)
        return self.nothing()

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
        self.losses.add("truncated", int(self._at > 0))
        words = self._take(b"", last=True) if self._at else None
        rows = self._words.feed(words or b"", final=True)
        return rows if len(rows[3]) else None

    def _take(self, data: bytes, last: bool) -> bytes | None:
        """Return the words of a frame once: those before its mark, or all of one without a mark."""
        if self._marked:  # what an earlier frame left
            return None
        size, looked = self._words.word_bytes, len(self._payload)
        self._payload += data
        looked, end = looked // size * size, len(self._payload) // size * size
        heads = self._words.heads(self._payload[looked:end])
        found = np.flatnonzero((heads & self._bits) == self._mark_value)
        if not (len(found) or last):
            return None
        self.losses.add("no_end_mark", int(not len(found)))
        payload = bytes(self._payload[: looked + int(found[0]) * size if len(found) else end])
        self._payload, self._marked = bytearray(), True
        return payload


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
