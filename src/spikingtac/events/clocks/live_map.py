"""A camera's clock on another camera's while both deliver: corrected gently, never backwards."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.cameras.clock import ClockMapping
from spikingtac.events.clocks.time_map import PPM, TimeMap, through_host

RENEW_US = 1_000_000
"""Time between two looks at the clocks, us: milliseconds are learned in it at first, microseconds
later."""
SLOWEST, FASTEST = -0.5, 1.0
"""Bounds of the correction of the pace: time goes on, at half to twice its pace."""
Known = Callable[[], ClockMapping | None]
"""Tells what is known of a clock now."""


class LiveMap:
    """Puts the times of one camera on the clock of another, through the host that receives both.

    What is known of the clocks grows while they run. A correction is spread over a second, so that
    times stay in order and nearly keep their intervals.

    Args:
        own: What is known of the camera's clock.
        base: What is known of the other one's.
    """

    def __init__(self, own: Known, base: Known) -> None:
        self._own, self._base = own, base
        self._line = TimeMap()
        self._renew_us: float | None = None

    @property
    def known(self) -> TimeMap | None:
        """The best map so far, or None before both cameras have delivered."""
        own, base = self._own(), self._base()
        return None if own is None or base is None else through_host(own, base)

    def __call__(self, t_us: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
        """Return ``(n,)`` times on the other clock, us; they follow the earlier ones in order."""
        if len(t_us) and (self._renew_us is None or int(t_us[0]) >= self._renew_us):
            self._renew(float(t_us[0]))
        return self._line(t_us)

    def _renew(self, now_us: float) -> None:
        target = self.known
        if target is None:  # the other camera is silent yet: as good as any
            return
        aim_us = target.base_us + (now_us - target.own_us) * (1.0 + target.drift_ppm * PPM)
        if self._renew_us is None:
            here_us, correction = aim_us, 0.0
        else:
            line = self._line
            here_us = line.base_us + (now_us - line.own_us) * (1.0 + line.drift_ppm * PPM)
            correction = min(max((aim_us - here_us) / RENEW_US, SLOWEST), FASTEST)
        drift = target.drift_ppm * PPM
        self._line = TimeMap(own_us=now_us, base_us=here_us, drift_ppm=(drift + correction) / PPM)
        self._renew_us = now_us + RENEW_US
