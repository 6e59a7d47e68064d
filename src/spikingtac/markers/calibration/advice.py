"""What to do next so that a calibration succeeds, in plain words."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from spikingtac.calibration.pitch import FEWEST_MARKERS, marker_pitch_px
from spikingtac.events.source import EventSource
from spikingtac.markers.calibration.guide import (
    ENOUGH_SHARE,
    FEWEST_RESTS,
    OPPOSITE,
    CalibrationGuide,
    GuideView,
)
from spikingtac.markers.calibration.quality import region
from spikingtac.types import EventPacket, LossCounters

# A grid that ends further from the image's border than so many pitches may go on unseen. (A
# pitch beyond the last marker there is room for one more.)
NEAR_BORDER_PITCHES = 1.5

# What to do while there is no grid.
FIRST = (
    "Slide a flat object or a finger over all of the skin, so that every marker moves by more than "
    "its diameter."
)

MOST_REGIONS = 3  # Regions that a sentence names.


def advice(view: GuideView) -> list[str]:
    """Return what to do next, the most pressing first; never empty.

    Args:
        view: What the guide knows.
    """
    if not len(view.place_px):
        return [FIRST]
    lines = [*_unmoved(view), *_unseen(view)]
    if view.rests < FEWEST_RESTS:
        lines.append("Take everything off the skin and wait half a second.")
    if not lines:
        lines.append(f"All {len(view.place_px)} markers have moved enough: calibrate now.")
    return lines


def progress_line(view: GuideView) -> str:
    """Return where a calibration stands and what it needs next, in one line."""
    begun = f"{view.t_us / 1e6:.1f} s"
    if not len(view.place_px):
        return f"{begun}: no grid yet. {advice(view)[0]}"
    shape = "no rows" if view.grid is None else "grid {}x{}".format(*view.grid)
    moved = f"{shape}, {int(view.enough.sum())} of {len(view.place_px)} markers moved"
    return f"{begun}: {moved} enough. {advice(view)[0]}"


def way_of(view: GuideView, marker: int) -> str:
    """Return which way a marker should go next: left, right, up or down."""
    return OPPOSITE[int(np.argmin(view.sides[marker]))]


def _unmoved(view: GuideView) -> list[str]:
    short = np.flatnonzero(~view.enough)
    if not len(short):
        return []
    lacking = np.maximum(ENOUGH_SHARE - view.sides[short], 0.0).sum(axis=0)
    way = OPPOSITE[int(np.argmax(lacking))]
    back = OPPOSITE[int(np.argmax(lacking)) ^ 1]
    counts: dict[str, int] = {}
    for place in view.place_px[short]:
        named = region(place, view.size)
        counts[named] = counts.get(named, 0) + 1
    most = sorted(counts, key=lambda name: -counts[name])[:MOST_REGIONS]
    where = "all over" if len(counts) > MOST_REGIONS else f"on the {' and the '.join(most)} of"
    one = len(short) == 1
    return [
        f"{len(short)} {'marker needs' if one else 'markers need'} more motion: "
        f"slide {way} and back {back} {where} the skin."
    ]


def _unseen(view: GuideView) -> list[str]:
    # Where the markers end well before the image does.
    if len(view.place_px) < FEWEST_MARKERS:
        return []
    low, high = view.place_px.min(axis=0), view.place_px.max(axis=0)
    gaps = {
        "left": low[0],
        "right": view.size[0] - 1 - high[0],
        "upper": low[1],
        "lower": view.size[1] - 1 - high[1],
    }
    far_px = NEAR_BORDER_PITCHES * marker_pitch_px(view.place_px)
    ends = [side for side, gap in gaps.items() if gap > far_px]
    if not ends:
        return []
    named = " and the ".join(ends)
    return [f"No marker has appeared near the {named} edge: if there are any, slide there too."]


TELL_US = 2_000_000  # Sensor time between two reports, us.


class GuidedSource:
    """Passes packets on, shows them to a guide meanwhile, and may end when enough has moved.

    Every attribute that is not named here is the source's own (``path``, ``close``).

    Args:
        source: Where the events come from.
        guide: Sees the events.
        tell: Called with the guide's view every two seconds of sensor time, and at the end.
        until_ready: End once a calibration has all that it needs.
    """

    size: tuple[int, int]
    losses: LossCounters

    def __init__(
        self,
        source: EventSource,
        guide: CalibrationGuide,
        tell: Callable[[GuideView], None],
        *,
        until_ready: bool = False,
    ) -> None:
        self._source, self._guide, self._tell = source, guide, tell
        self._until_ready = until_ready

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # copies ask before there is a source
            raise AttributeError(name)
        return getattr(self._source, name)

    def __iter__(self) -> Iterator[EventPacket]:
        """Yield the source's packets."""
        self._guide.reset()
        told_us: int | None = None
        for packet in self._source:
            self._guide.absorb(packet)
            yield packet
            told_us = packet.t_start_us if told_us is None else told_us
            if packet.t_end_us - told_us >= TELL_US:
                told_us = packet.t_end_us
                self._tell(self._guide.view())
            if self._until_ready and self._guide.complete:
                self._end()
                break
        self._tell(self._guide.view())

    def _end(self) -> None:
        close = getattr(self._source, "close", None)
        if close is not None:
            close()
