"""Events in the datagrams of AEStream and of SPIF boards.

Source: AEStream (MIT), ``src/cpp/output/dvs_to_udp.cpp``. An event takes a little-endian 32-bit
word: the column in bits 16 to 30, the row in bits 0 to 14, the polarity in bit 15. Where bit 31 is
clear, a second word holds the time in us, which wraps after 71 minutes; where it is set, the event
carries no time and gets that of its arrival.
"""

from __future__ import annotations

import time
from itertools import groupby
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from spikingtac.cameras.udp import DatagramCamera
from spikingtac.errors import ConfigError
from spikingtac.events.address import Address
from spikingtac.events.formats.file_source import Rows

WORD_BYTES = 4
NO_TIME = 1 << 7  # Bit 31 of a word, in the last one of its bytes.
WRAP_US = 1 << 32
US_PER_S = 1e6


class AestreamCamera(DatagramCamera):
    """Datagrams with or without times; a datagram has only one kind of events."""

    OPTIONS: ClassVar[tuple[str, ...]] = ("size",)

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
        return len(datagram) >= WORD_BYTES

    def _decoded(self, datagrams: list[bytes]) -> Rows:
        # Those of one kind are decoded at once: what each costs alone is many times its events'.
        kinds = groupby(map(self._whole_events, datagrams), key=_is_timed)
        parts = [self._events(b"".join(group), timed) for timed, group in kinds]
        x, y, p, t = (np.concatenate(column) for column in zip(*parts, strict=True))
        return x, y, p, t

    def describe(self) -> dict[str, Any]:
        """Return port and encoding."""
        return {"port": self._socket.port, "encoding": "AEStream datagrams"}

    def _whole_events(self, datagram: bytes) -> bytes:
        """Return the whole events of a datagram."""
        size = 2 * WORD_BYTES if _is_timed(datagram) else WORD_BYTES
        whole = len(datagram) // size * size
        self.losses.add("truncated", int(whole < len(datagram)))
        return datagram[:whole]

    def _events(self, data: bytes, timed: bool) -> Rows:
        words = np.frombuffer(data, "<u4")
        if timed:
            heads = words[::2]
            t = self._unwrapped(words[1::2])
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
    return len(datagram) >= WORD_BYTES and not datagram[WORD_BYTES - 1] & NO_TIME
