"""EVT words in UDP datagrams without framing, as an STM32 board with a GenX320 sends them.

Each datagram begins with a whole word. Nothing numbers them: what the network loses shows only as a
leap of the time words, so that loss is told where it can be known (the kernel's count of datagrams
that overran this socket, datagrams that came twice or late).
"""

from __future__ import annotations

import select
import socket
import struct
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any, ClassVar, Self

from spikingtac.cameras.words import WORD_OPTIONS, BareWords
from spikingtac.errors import DeviceError, FormatError
from spikingtac.events.address import Address
from spikingtac.events.camera import Camera
from spikingtac.events.evt.words import Rows

# Where is listened unless an address of this machine is given; 0.0.0.0 hears every network.
LOOPBACK = "127.0.0.1"
LARGEST_BYTES = 1 << 16  # No datagram is larger.
AT_ONCE = 64  # Datagrams that one read takes at most: 3 Mev/s bring 8 in a millisecond.

# Socket buffer that is asked for: 0.7 s at 3 Mev/s. The kernel may grant less.
BUFFER_BYTES = 8 << 20

# A sender that has been silent for so long may be followed by another one, s (ours).
SILENT_S = 1.0
JUDGED_BYTES = 1 << 14  # Refused bytes from which on is said which encoding they fit.
REMEMBERED = 32  # Latest datagrams that a new one is compared with, to tell one that came twice.

# Linux: figures of a socket's memory; the last one is the count of datagrams that were dropped.
SO_MEMINFO = 55
_MEMINFO = struct.Struct("=9I")
LONGEST_WORD = 8  # bytes, of EVT2.1


class UdpSocket:
    """A bound socket that yields datagrams of one sender and counts what was lost.

    The first sender whose datagram is accepted is heard until it falls silent.

    Args:
        address: Target ``PORT`` or ``HOST:PORT`` (an address of this machine to listen on).
        accepts: Whether a datagram of a new sender is one of the camera.
        losses: Counters to fill: ``overflow``, ``duplicate``, ``foreign``.

    Attributes:
        port: The port, also where the system has chosen it.
        buffer_bytes: Size of the buffer that the kernel grants.

    Raises:
        ConfigError: The target is no port.
        DeviceError: The port cannot be listened on.
    """

    def __init__(self, address: Address, losses: Any, accepts: Callable[[bytes], bool]) -> None:
        place = address.host_port(LOOPBACK, low=0)
        self._losses, self._accepts = losses, accepts
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
        self._heard_s = 0.0
        self._dropped = 0
        self._latest: deque[bytes] = deque(maxlen=REMEMBERED)

    def datagrams(self, timeout_s: float) -> list[bytes]:
        """Return the datagrams that wait, after waiting for the first one."""
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
        return found

    def close(self) -> None:
        """Release the port; further calls do nothing."""
        if self._socket.fileno() >= 0:
            self._count_dropped()
        self._socket.close()

    def _is_new(self, data: bytes, sender: tuple[str, int]) -> bool:
        now_s = time.monotonic()
        if sender != self._sender:
            engaged = self._sender is not None and now_s - self._heard_s < SILENT_S
            if engaged or not self._accepts(data):
                self._losses.add("foreign")
                return False
            self._sender = sender
            self._latest.clear()
        self._heard_s = now_s
        if data in self._latest:
            self._losses.add("duplicate")
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
            self._losses.add("overflow", (total - self._dropped) & 0xFFFFFFFF)
            self._dropped = total


class DatagramCamera(Camera):
    """A camera whose events come in datagrams; its kind says what these hold.

    Args:
        address: Its target is the port to listen on.
    """

    def __init__(self, address: Address) -> None:
        super().__init__()
        self._prepare(address)
        self._socket = UdpSocket(address, self.losses, self._accepts)
        self._closed = False

    @classmethod
    def open(cls, address: Address) -> Self:
        """Listen; see :meth:`Camera.open`."""
        return cls(address)

    @property
    def port(self) -> int:
        """The port that is listened on."""
        return self._socket.port

    def read(self, timeout_s: float) -> Rows | None:
        """Return the events of the datagrams that wait; see :meth:`Camera.read`."""
        if self._closed:
            return None
        datagrams = self._socket.datagrams(timeout_s)
        return self._decoded(datagrams) if datagrams else self.nothing()

    def close(self) -> None:
        """Release the port."""
        self._closed = True
        self._socket.close()

    @abstractmethod
    def _prepare(self, address: Address) -> None:
        """Take the options of the address, and the sensor's size, before the port is opened."""

    @abstractmethod
    def _accepts(self, datagram: bytes) -> bool:
        """Return whether a datagram is one of such a camera."""

    @abstractmethod
    def _decoded(self, datagrams: list[bytes]) -> Rows:
        """Return the events of some datagrams."""


class UdpCamera(DatagramCamera):
    """Datagrams of EVT2, EVT2.1 or EVT3 words."""

    OPTIONS: ClassVar[tuple[str, ...]] = WORD_OPTIONS
    checked = True

    def _prepare(self, address: Address) -> None:
        self._address, self._refused = address, b""
        self._words = BareWords(address, self.losses, self.triggers)
        self.size = self._words.size

    def _accepts(self, datagram: bytes) -> bool:
        """Judge a datagram by its words.

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
        whole = self._words.in_order([self._whole_words(item) for item in datagrams])
        return self._words.feed(b"".join(whole))

    def describe(self) -> dict[str, Any]:
        """Return port, encoding and buffer."""
        granted = {"port": self._socket.port, "socket_buffer_bytes": self._socket.buffer_bytes}
        return granted | self._words.describe()

    def _whole_words(self, datagram: bytes) -> bytes:
        """Return the whole words of a datagram: the next one begins with a whole one again."""
        size = self._words.word_bytes
        if len(datagram) % size:
            self.losses.add("truncated")
        return datagram[: len(datagram) // size * size]
