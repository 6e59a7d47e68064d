"""A recording's events on another clock."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from spikingtac.events.clocks.live_map import LiveMap
from spikingtac.events.clocks.time_map import TimeMap
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows


class RetimedSource(FileSource):
    """The events of a source with their times on the clock of another one.

    Events from before that clock's zero have no time on it: they are dropped and counted as
    ``before_zero``.

    Args:
        source: The events.
        time_map: From its clock to the other one.
        options: As of the source.
    """

    def __init__(
        self, source: FileSource, time_map: TimeMap | LiveMap, options: ReadOptions
    ) -> None:
        self._source, self._map = source, time_map
        self.checked = source.checked
        super().__init__(source.path, options)
        self.format = source.format
        self.notes = [*source.notes]
        if isinstance(time_map, TimeMap):
            self.notes.append(f"times are on the first sensor's clock ({_words(time_map)})")

    def _size(self) -> tuple[int, int]:
        return self._source.size

    def _columns(self) -> Iterator[Rows]:
        self._source.losses, self._source.triggers = self.losses, Triggers()
        for x, y, p, own_us in self._source.columns():
            self.progress = self._source.progress
            t = self._map(np.asarray(own_us))
            if len(t) and t[0] < 0:
                keep = t >= 0
                self.losses.add("before_zero", int(len(t) - np.count_nonzero(keep)))
                x, y, p, t = x[keep], y[keep], p[keep], t[keep]
            self._place_triggers()
            yield x, y, p, t
        self._place_triggers()

    def _place_triggers(self) -> None:
        """Put the trigger edges met so far on the other clock, too."""
        edges = self._source.triggers
        if len(edges):
            self.triggers.append(self._map(edges.t_us), edges.channel, edges.edge)
            edges.clear()


def _words(time_map: TimeMap) -> str:
    return (
        f"drift {time_map.drift_ppm:.1f} ppm, error {time_map.error_us:.0f} us, "
        f"learned from {time_map.learned_from}"
    )
