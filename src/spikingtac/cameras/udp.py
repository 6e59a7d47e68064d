"""Events in UDP datagrams of EVT words, as an STM32 board with a GenX320 sends them.

Each datagram begins with a whole word. Nothing numbers them: what the network loses shows only as a
leap of the time words, so that loss is told where it can be known (the kernel's count of datagrams
that overran this socket, datagrams that came twice or late).
"""

import select
import socket
import struct
import time
from collections import deque
from typing import Any, ClassVar, Self

from spikingtac.cameras.words import WORD_OPTIONS, CameraWords, header_of
from spikingtac.errors import DeviceError, FormatError
from spikingtac.events.camera import Address, Camera
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


class UdpCamera(Camera):
    """Datagrams of EVT2, EVT2.1 or EVT3 words.

    The first sender whose datagram is accepted is heard until it falls silent. What was lost is
    counted: ``overflow``, ``duplicate``, ``foreign``.

    Args:
        address: Its target is ``PORT`` or ``HOST:PORT``, an address of this machine to listen on.

    Attributes:
        port: The port, also where the system has chosen it.

    Raises:
        ConfigError: An option is not valid.
        DeviceError: The port cannot be listened on.
    """

    OPTIONS: ClassVar[tuple[str, ...]] = WORD_OPTIONS
    checked = True

    def __init__(self, address: Address) -> None:
        super().__init__()
        self._words = CameraWords(header_of(address), self.losses, self.triggers)
        self._address, self.size = address, self._words.size
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
        self._sender: tuple[str, int] | None = None
        self._heard_s, self._dropped = 0.0, 0
        self._latest: deque[bytes] = deque(maxlen=REMEMBERED)
        self._refused = b""

    @classmethod
    def open(cls, address: Address) -> Self:
        """Listen; see :meth:`Camera.open`."""
        return cls(address)

    def read(self, timeout_s: float) -> Rows | None:
        """Return the events of the datagrams that wait; see :meth:`Camera.read`."""
        if self._socket.fileno() < 0:
            return None
        ready, _, _ = select.select([self._socket], [], [], timeout_s)
        found: list[bytes] = []
        word_bytes = self._words.word_bytes
        while ready and len(found) < AT_ONCE:
            try:
                data, sender = self._socket.recvfrom(LARGEST_BYTES)
            except BlockingIOError:
                break
            if self._is_new(data, sender):
                # The next datagram begins with a whole word again.
                cut = len(data) % word_bytes
                self.losses.add("truncated", int(cut > 0))
                found.append(data[: len(data) - cut])
        self._count_dropped()
        return self._words.feed(b"".join(self._words.in_order(found))) if found else self.nothing()

    def close(self) -> None:
        """Release the port."""
        if self._socket.fileno() >= 0:
            self._count_dropped()
        self._socket.close()

    def describe(self) -> dict[str, Any]:
        """Return port and encoding."""
        return {"port": self.port, **self._words.describe()}

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

    def _accepts(self, datagram: bytes) -> bool:
        """Return whether a datagram is one of such a camera, by its words.

        Raises:
            FormatError: Those that came so far are of another encoding.
        """
        if self._words.fits(datagram):
            self._refused = b""
            return True
        if self._sender is not None:  # the camera's encoding is known: this is somebody else's
            return False
        self._refused += datagram[: len(datagram) // LONGEST_WORD * LONGEST_WORD]
        if len(self._refused) >= JUDGED_BYTES:
            better, self._refused = self._words.fitting(self._refused), b""
            if better is not None:
                raise FormatError(
                    f"{str(self._address)!r}: the datagrams that come are of another encoding; "
                    f"give the one that fits: {better}"
                )
        return False

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
