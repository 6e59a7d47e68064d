"""The tracker of a sensor whose markers are not known: it follows none, and feeds a guide."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.calibration.guide.guide import CalibrationGuide
from spikingtac.types import EventPacket, MarkerFrame


class GuideTracker:
    """Shows every event to a guide once.

    All copies are the tracker itself: what was seen stays seen when the viewer goes back in time,
    and a stretch that is played again tells nothing new.

    Args:
        size: ``(width, height)`` of the sensor, px.

    Attributes:
        guide: Sees the events.
        begin_us: Time of the first event that the guide has seen, us; None before.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self.guide = CalibrationGuide(size)
        self.begin_us: int | None = None
        self._seen_us = 0

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self

    @property
    def state_map(self) -> GuideTracker:
        """The map that the page may show: this tracker's own."""
        return self

    @property
    def values(self) -> NDArray[np.float32]:
        """``(height, width)`` levels from 0 (ground) to 1 (marker)."""
        return self.guide.level

    def absorb(self, packet: EventPacket) -> None:
        """Show the guide what it has not seen."""
        if self.begin_us is None:
            self.begin_us = packet.t_start_us
        elif packet.t_start_us < self._seen_us:
            return
        self._seen_us = packet.t_end_us
        self.guide.absorb(packet)

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return an estimate of no marker."""
        places = np.empty((0, 2))
        return MarkerFrame(
            t_us=t_us,
            detected_px=places,
            position_px=places,
            displacement_px=places,
            coasted=np.empty(0, bool),
            confidence=np.empty(0),
        )

    def reset(self) -> None:
        """Do nothing: what was seen stays seen."""

    def begin_anew(self) -> None:
        """Forget all events; the guide begins with the next one."""
        self.guide.reset()
        self.begin_us = None
