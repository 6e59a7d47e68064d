"""Two cameras that are read side by side, the second one's times on the first one's clock.

Both readers begin with the first use of either: an event that waited for its reader would arrive
late by the host's clock, through which the two cameras' clocks meet.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.camera_source import CameraSource
from spikingtac.events.clock import PPM, TimeMap
from spikingtac.events.formats.file_source import ReadOptions, Rows
from spikingtac.events.recording import RetimedSource
from spikingtac.stream.packets import at_once
from spikingtac.stream.reader import POLL_S, EventReader, LiveSource

# Time between two looks at the clocks, us: milliseconds are learned in it at first, microseconds
# later.
RENEW_US = 1_000_000

# Bounds of the correction of the pace: time goes on, at half to twice its pace.
SLOWEST, FASTEST = -0.5, 1.0

Known = Callable[[], TimeMap | None]  # Tells what is known of a clock now.

# Wait of a camera that delivers for one that is silent, s (cameras start within one).
SILENCE_S = 2.0


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
        return None if own is None or base is None else own.then(base.inverse())

    def __call__(self, t_us: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
        """Return ``(n,)`` times on the other clock, us; they follow the earlier ones in order."""
        if len(t_us) and (self._renew_us is None or int(t_us[0]) >= self._renew_us):
            self._renew(float(t_us[0]))
        return self._line(t_us)

    def _renew(self, now_us: float) -> None:
        target = self.known
        if target is None:  # the other camera is silent yet: as good as any
            return
        aim_us = target.at(now_us)
        if self._renew_us is None:
            here_us, correction = aim_us, 0.0
        else:
            here_us = self._line.at(now_us)
            correction = min(max((aim_us - here_us) / RENEW_US, SLOWEST), FASTEST)
        drift = target.drift_ppm * PPM
        self._line = TimeMap(own_us=now_us, base_us=here_us, drift_ppm=(drift + correction) / PPM)
        self._renew_us = now_us + RENEW_US


class FirstCamera(LiveSource):
    """The camera whose clock is the time base; one that was silent at first is put on the other's.

    Attributes:
        live_map: Puts the times on the other camera's clock, or None.
    """

    live_map: LiveMap | None = None

    def __init__(self, camera: CameraSource) -> None:
        super().__init__(lambda: EventReader(at_once(camera), camera), camera.size, camera.path)
        self.camera = camera
        self.beside: list[FirstCamera] = [self]

    @property
    def ended(self) -> bool:
        """True once nothing more comes from the camera."""
        return self.start().ended

    def _columns(self) -> Iterator[Rows]:
        for source in self.beside:
            source.start()
        for x, y, p, t in super()._columns():
            yield x, y, p, t if self.live_map is None else self.live_map(t)


class OnAnotherClock(RetimedSource):
    """A camera's events on another camera's clock.

    A camera that is silent does not hold this one back: after ``SILENCE_S`` the events are given
    out with their own times, to the end, and ``own_clock`` is counted. When the silent camera
    begins after all, its times are put on this one's clock instead.

    Attributes:
        live_map: How the times are mapped now.
    """

    def __init__(self, source: FirstCamera, live_map: LiveMap, options: ReadOptions) -> None:
        super().__init__(source, live_map, options)
        self.live_map, self._camera = live_map, source

    def close(self) -> None:
        """End the iteration soon."""
        self._camera.close()

    def _columns(self) -> Iterator[Rows]:
        first, own = self._camera.beside
        readers = [source.start() for source in (first, own)]
        # Times that were given out cannot be corrected backwards: wait until both have delivered.
        begun_s: float | None = None
        while self.live_map.known is None and not any(reader.ended for reader in readers):
            time.sleep(POLL_S)
            if begun_s is None and readers[1].ring.weight:
                begun_s = time.monotonic()
            if begun_s is not None and time.monotonic() - begun_s > SILENCE_S:
                self._map = TimeMap()
                first.live_map = LiveMap(first.camera.clock.mapping, own.camera.clock.mapping)
                self.losses.add("own_clock")
                break
        yield from super()._columns()


def live_pair(
    first: CameraSource, second: CameraSource, options: ReadOptions
) -> tuple[FirstCamera, OnAnotherClock]:
    """Return two cameras such that the second one's times are on the first one's clock.

    Args:
        first: Its clock is the time base.
        second: The other one.
        options: As of both.
    """
    live_map = LiveMap(second.clock.mapping, first.clock.mapping)
    both = FirstCamera(first), FirstCamera(second)
    for source in both:
        source.beside = list(both)
    return both[0], OnAnotherClock(both[1], live_map, options)
