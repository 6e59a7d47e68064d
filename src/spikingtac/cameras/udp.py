"""EVT words in UDP datagrams without framing, as an STM32 board with a GenX320 sends them.

Each datagram begins with a whole word. Nothing numbers them: what the network loses shows only as a
leap of the time words, so that loss is told where it can be known (the kernel's count of datagrams
that overran this socket, datagrams that came twice or late).
"""

from __future__ import annotations

import select
import socket
import struct
from abc import abstractmethod
from collections import deque
from typing import Any, ClassVar, Self

from spikingtac.cameras.words import WORD_OPTIONS, BareWords
from spikingtac.errors import DeviceError
from spikingtac.events.address import Address
from spikingtac.events.cameras.camera import Camera
from spikingtac.events.evt.words import Rows

ANY_HOST = "0.0.0.0"  # a camera on a cable of its own sends from another machine
LARGEST_BYTES = 1 << 16
"""No datagram is larger."""
AT_ONCE = 64
"""Datagrams that one read takes at most: 3 Mev/s bring 8 in a millisecond."""
BUFFER_BYTES = 8 << 20
"""Socket buffer that is asked for: 0.7 s at 3 Mev/s. The kernel may grant less."""
REMEMBERED = 32
"""Latest datagrams that a new one is compared with, to tell one that came twice."""
SO_MEMINFO = 55
"""Linux: figures of a socket's memory; the last one is the count of datagrams that were dropped."""
_MEMINFO = struct.Struct("=9I")


class UdpSocket:
    """A bound socket that yields datagrams of one sender and counts what was lost.

    Args:
        address: Target ``PORT`` or ``HOST:PORT`` (an address of this machine to listen on).
        losses: Counters to fill: ``overflow``, ``duplicate``, ``foreign``.

    Attributes:
        port: The port, also where the system has chosen it.
        buffer_bytes: Size of the buffer that the kernel grants.

    Raises:
        ConfigError: The target is no port.
        DeviceError: The port cannot be listened on.
    """

    def __init__(self, address: Address, losses: Any) -> None:
        place = address.host_port(ANY_HOST, low=0)
        self._losses = losses
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
        self._sender: str | None = None
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
            if self._is_new(data, sender[0]):
                found.append(data)
        self._count_dropped()
        return found

    def close(self) -> None:
        """Release the port; further calls do nothing."""
        if self._socket.fileno() >= 0:
            self._count_dropped()
        self._socket.close()

    def _is_new(self, data: bytes, sender: str) -> bool:
        self._sender = self._sender or sender
        if sender != self._sender:
            self._losses.add("foreign")
            return False
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
        self._socket = UdpSocket(address, self.losses)
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
    def _decoded(self, datagrams: list[bytes]) -> Rows:
        """Return the events of some datagrams."""


class UdpCamera(DatagramCamera):
    """Datagrams of EVT2, EVT2.1 or EVT3 words."""

    OPTIONS: ClassVar[tuple[str, ...]] = WORD_OPTIONS
    checked = True

    def _prepare(self, address: Address) -> None:
        self._words = BareWords(address, self.losses, self.triggers)
        self.size = self._words.size

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
