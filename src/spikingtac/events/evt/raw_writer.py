"""Writes Prophesee RAW files in EVT2, EVT2.1 or EVT3, packet by packet."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.errors import FormatError, named
from spikingtac.events.evt.encode import ENCODERS, WordEncoder
from spikingtac.events.evt.raw import format_header
from spikingtac.events.formats.codec import OneFileWriter, Triggers
from spikingtac.types import US_PER_DAY, EventPacket


class RawWriter(OneFileWriter):
    """A RAW file that grows packet by packet; the same events always give the same bytes.

    Times beyond the counter of the wire are kept: the header names the base of the first event.

    Args:
        path: File to write; replaced if it exists.
        size: ``(width, height)``, px, at most 2048 each.
        encoding: ``evt2``, ``evt21`` (little-endian words) or ``evt3``.
        in_place: For a recorder: what came so far stands at the path, also if it is killed.
        digest: Updated with every byte of the file, as one of hashlib.

    Attributes:
        written_bytes: Bytes given to the file so far.

    Raises:
        ConfigError: The encoding is unknown.
        FormatError: The sensor does not fit into eleven-bit addresses.
    """

    side_limit_px = 1 << 11  # An address has eleven bits.

    def __init__(
        self,
        path: str | Path,
        size: tuple[int, int],
        encoding: str = "evt3",
        *,
        in_place: bool = False,
        digest: Any = None,
    ) -> None:
        self._encoder: WordEncoder = named(ENCODERS, encoding, "encoding")()
        super().__init__(path, size, in_place=in_place)
        self._base_us: int | None = None
        self._last_us = self.written_bytes = 0
        self._waiting: list[tuple[int, int, bool]] = []
        self._digest = digest

    def _add(self, packet: EventPacket) -> None:
        if not len(packet):
            return
        base_us = self._base_us
        if base_us is None:
            base_us = self._begin(int(min([packet.t[0], *(edge[0] for edge in self._waiting[:1])])))
        self._check(packet)
        edges = [edge for edge in self._waiting if edge[0] <= packet.t[-1]]
        del self._waiting[: len(edges)]
        places = packet.t.searchsorted([edge[0] for edge in edges], side="right").tolist()
        first = 0
        for edge, last in [*zip(edges, places, strict=True), (None, len(packet))]:
            if last > first:
                t, part = packet.t[first:last] - base_us, slice(first, last)
                columns = packet.x[part], packet.y[part], packet.p[part]
                self._append(self._encoder.encode(t, *columns).tobytes())
                self._last_us, first = int(packet.t[last - 1]), last
            if edge is not None:
                self._append_trigger(*edge)

    def add_triggers(self, triggers: Triggers) -> None:
        """Take trigger edges, to be written among the events that come after this call.

        Edges from before the events that were written are left out, and counted.
        """
        self._waiting.extend(triggers)

    def _append_trigger(self, t_us: int, channel: int, rising: bool) -> None:
        base_us = self._begin(t_us) if self._base_us is None else self._base_us
        if t_us < max(self._last_us, base_us):
            self.triggers_left_out += 1
            return
        self._last_us = t_us
        self._append(self._encoder.trigger(t_us - base_us, channel, rising).tobytes())

    def flush(self, durable: bool = False) -> None:
        """Hand what was written to the operating system: it survives the death of this process.

        Args:
            durable: Wait until it is on the disk, so that it survives the loss of power, too.
        """
        if not self._file.closed:
            self._file.flush()
            if durable:
                os.fsync(self._file.fileno())

    def _finish(self) -> None:
        for trigger in self._waiting:
            self._append_trigger(*trigger)
        if self._base_us is None:  # a file without events holds its header alone
            self._begin(0)

    def _begin(self, first_us: int) -> int:
        """Write the header, and return the base of all times, us."""
        period_bits = self._encoder.form.low_bits + self._encoder.form.high_bits
        self._base_us = base_us = (max(first_us, 0) >> period_bits) << period_bits
        self._last_us = first_us
        self._append(format_header(self._encoder.name, self.size, base_us))
        return base_us

    def _append(self, data: bytes) -> None:
        if self._file.closed:
            raise FormatError("the file is closed; open another to write more events")
        self._file.write(data)
        self.written_bytes += len(data)
        if self._digest is not None:
            self._digest.update(data)

    def _check(self, packet: EventPacket) -> None:
        steps = np.diff(packet.t, prepend=self._last_us)
        if packet.t[0] < 0 or steps[0] < 0:
            raise FormatError(
                f"RAW times rise from 0 us on, {packet.t[0]} us came: sort, or convert --shift-us N"
            )
        if int(steps.max()) > US_PER_DAY:
            raise FormatError("a pause of more than a day cannot be written; split the recording")
