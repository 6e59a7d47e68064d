"""Events in UDP datagrams: EVT words, as an STM32 board with a GenX320 sends them, or AEStream's.

Each datagram begins with a whole word. Nothing numbers them: what the network loses shows only as a
leap of the time words, so that loss is told where it can be known (the kernel's count of datagrams
that overran this socket, datagrams that came twice or late).
"""

from __future__ import annotations

import select
import socket
import struct
import time
from collections import deque
from itertools import groupby
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from spikingtac.cameras.words import WORD_OPTIONS, BareWords
from spikingtac.errors import ConfigError, DeviceError, FormatError
from spikingtac.events.address import Address
from spikingtac.events.camera import Camera
from spikingtac.events.evt.words import Rows

# Where is listened unless an address of this machine is given; 0.0.0.0 hears every network.
LOOPBACK = "127.0.0.1"
LARGEST_BYTES = 1 << 16  # No datagram is larger.
AT_ONCE = 64  # Datagrams that one read takes at most: 3 Mev/s bring 8 in a millisecond.

# Socket buffer that is asked for: 0.7 s at 3 Mev/s. The kernel may grant less.
BUFFER_BYTES = 8 << 20

# A sender that has been silent for so long may be followed by another one, s.
SILENT_S = 1.0
JUDGED_BYTES = 1 << 14  # Refused bytes from which on is said which encoding they fit.
REMEMBERED = 32  # Latest datagrams that a new one is compared with, to tell one that came twice.

# Linux: figures of a socket's memory; the last one is the count of datagrams that were dropped.
SO_MEMINFO = 55
_MEMINFO = struct.Struct("=9I")
LONGEST_WORD = 8  # bytes, of EVT2.1

EVENT_BYTES = 4  # Of an AEStream event without its time.
NO_TIME = 1 << 7  # Bit 31 of its word, in the last one of its bytes.
WRAP_US, US_PER_S = 1 << 32, 1e6


class UdpCamera(Camera):
    """Datagrams of EVT2, EVT2.1 or EVT3 words.

    The first sender whose datagram is accepted is heard until it falls silent. What was lost is
    counted: ``overflow``, ``duplicate``, ``foreign``.

    Args:
        address: Its target is ``PORT`` or ``HOST:PORT``, an address of this machine to listen on.

    Attributes:
        port: The port, also where the system has chosen it.
        buffer_bytes: Size of the buffer that the kernel grants.

    Raises:
        ConfigError: The target is no port.
        DeviceError: The port cannot be listened on.
    """

    OPTIONS: ClassVar[tuple[str, ...]] = WORD_OPTIONS
    checked = True

    def __init__(self, address: Address) -> None:
        super().__init__()
        self._address = address
        self._prepare(address)
        place = address.host_port(LOOPBACK, low=0)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            self._socket.setblocking(False)
            self._socket.bind(place)
        except OSError as error:
            self._socket.close()
            raise DeviceError(
                f"{str(address)!r}: cannot listen on {place[0]}:{place[1]} ({error.strerror}); "
                "is another program reading this camera? choose another port, or end that program"
            ) from error
        self.port: int = self._socket.getsockname()[1]
        self.buffer_bytes = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        self._sender: tuple[str, int] | None = None
        self._heard_s, self._dropped, self._closed = 0.0, 0, False
        self._latest: deque[bytes] = deque(maxlen=REMEMBERED)

    @classmethod
    def open(cls, address: Address) -> Self:
        """Listen; see :meth:`Camera.open`."""
        return cls(address)

    def read(self, timeout_s: float) -> Rows | None:
        """Return the events of the datagrams that wait; see :meth:`Camera.read`."""
        if self._closed:
            return None
        ready, _, _ = select.select([self._socket], [], [], timeout_s)
        found: list[bytes] = []
        while ready and len(found) < AT_ONCE:
            try:
                data, sender = self._socket.recvfrom(LARGEST_BYTES)
            except BlockingIOError:
                break
            if self._is_new(data, sender):
                found.append(data)
        self._count_dropped()
        return self._decoded(found) if found else self.nothing()

    def close(self) -> None:
        """Release the port."""
        self._closed = True
        if self._socket.fileno() >= 0:
            self._count_dropped()
        self._socket.close()

    def _is_new(self, data: bytes, sender: tuple[str, int]) -> bool:
        now_s = time.monotonic()
        if sender != self._sender:
            engaged = self._sender is not None and now_s - self._heard_s < SILENT_S
            if engaged or not self._accepts(data):
                self.losses.add("foreign")
                return False
            self._sender = sender
            self._latest.clear()
        self._heard_s = now_s
        if data in self._latest:
            self.losses.add("duplicate")
            return False
        self._latest.append(data)
        return bool(data)

    def _count_dropped(self) -> None:
        """Count what the kernel has dropped since the last look, also where nothing follows it."""
        try:
            told = self._socket.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, _MEMINFO.size)
        except OSError:  # another system: it does not tell
            return
        if len(told) == _MEMINFO.size:
            total = _MEMINFO.unpack(told)[-1]
            self.losses.add("overflow", (total - self._dropped) & 0xFFFFFFFF)
            self._dropped = total

    def _prepare(self, address: Address) -> None:
        """Take the options of the address, and the sensor's size, before the port is opened."""
        self._refused = b""
        self._words = BareWords(address, self.losses, self.triggers)
        self.size = self._words.size

    def _accepts(self, datagram: bytes) -> bool:
        """Return whether a datagram is one of such a camera, by its words.

        Raises:
            FormatError: Those that came so far are of another encoding.
        """
        if self._words.fits(datagram):
            self._refused = b""
            return True
        whole = len(datagram) // LONGEST_WORD * LONGEST_WORD
        self._refused += datagram[:whole]
        if len(self._refused) >= JUDGED_BYTES:
            better, self._refused = self._words.fitting(self._refused), b""
            if better is not None:
                raise FormatError(
                    f"{str(self._address)!r}: the datagrams that come are of another encoding; "
                    f"give the one that fits: {better}"
                )
        return False

    def _decoded(self, datagrams: list[bytes]) -> Rows:
        """Return the events of some datagrams; the next one begins with a whole word again."""
        size = self._words.word_bytes
        whole = [self._whole(item, size) for item in datagrams]
        return self._words.feed(b"".join(self._words.in_order(whole)))

    def _whole(self, datagram: bytes, size: int) -> bytes:
        """Return a datagram's whole items of so many bytes."""
        self.losses.add("truncated", int(len(datagram) % size > 0))
        return datagram[: len(datagram) // size * size]

    def describe(self) -> dict[str, Any]:
        """Return port, encoding and buffer."""
        granted = {"port": self.port, "socket_buffer_bytes": self.buffer_bytes}
        return granted | self._words.describe()


class AestreamCamera(UdpCamera):
    """Events in the datagrams of AEStream and of SPIF boards, each with or without times.

    Source: AEStream (MIT), ``src/cpp/output/dvs_to_udp.cpp``. An event takes a little-endian 32-bit
    word: the column in bits 16 to 30, the row in bits 0 to 14, the polarity in bit 15. Where bit 31
    is clear, a second word holds the time in us, which wraps after 71 minutes; where it is set, the
    event carries no time and gets that of its arrival.
    """

    OPTIONS: ClassVar[tuple[str, ...]] = ("size",)
    checked = False

    def _prepare(self, address: Address) -> None:
        size = address.size("size")
        if size is None:
            raise ConfigError(
                f"{str(address)!r}: the datagrams name no size; give the sensor's: "
                "aestream:3333?size=346x260"
            )
        self.size = size
        self._epoch_us, self._last_us = 0, 0
        self._begun_s = time.monotonic()

    def _accepts(self, datagram: bytes) -> bool:
        return len(datagram) >= EVENT_BYTES

    def _decoded(self, datagrams: list[bytes]) -> Rows:
        # Those of one kind are decoded at once: what each costs alone is many times its events'.
        parts = [
            self._events([self._whole(item, EVENT_BYTES * (1 + timed)) for item in group], timed)
            for timed, group in groupby(datagrams, key=_is_timed)
        ]
        x, y, p, t = (np.concatenate(column) for column in zip(*parts, strict=True))
        return x, y, p, t

    def describe(self) -> dict[str, Any]:
        """Return port and encoding."""
        return {"port": self.port, "encoding": "AEStream datagrams"}

    def _events(self, pieces: list[bytes], timed: bool) -> Rows:
        words = np.frombuffer(b"".join(pieces), "<u4")
        if timed:
            heads, t = words[::2], self._unwrapped(words[1::2])
        else:
            heads = words
            now_us = round((time.monotonic() - self._begun_s) * US_PER_S)
            t = np.full(len(heads), now_us, np.int64)
        x, y = (heads >> 16) & 0x7FFF, heads & 0x7FFF
        return x.astype(np.uint16), y.astype(np.uint16), (heads & 0x8000) > 0, t

    def _unwrapped(self, low: NDArray[np.uint32]) -> NDArray[np.int64]:
        """Return times beyond the 32 bits of the wire: a fall by half of the range is a wrap."""
        times = low.astype(np.int64) + self._epoch_us
        if not len(times):
            return times
        falls = times < np.concatenate(([self._last_us], times[:-1])) - WRAP_US // 2
        if falls.any():
            times += np.cumsum(falls) * WRAP_US
            self._epoch_us += int(falls.sum()) * WRAP_US
        self._last_us = int(times[-1])
        return times


def _is_timed(datagram: bytes) -> bool:
    """Return whether the events of a datagram carry times."""
    return len(datagram) >= EVENT_BYTES and not datagram[EVENT_BYTES - 1] & NO_TIME
