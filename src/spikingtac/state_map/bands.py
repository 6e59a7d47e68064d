"""The band map: the level at which each pixel fired last, and how well that is known.

A pixel fires when its brightness has left the level of its last event by a threshold, so that its
brightness lies in a band around that level: at most an OFF step below it, at most an ON step above.
Where OFF events are rare this band is wide, and a single expected level
(:mod:`spikingtac.state_map.graded`) is wrong by a third of a swing; the level at the moment of an
event is not. Its variance grows with each event, since thresholds differ between pixels, and
shrinks when a fitted disc confirms it (:mod:`spikingtac.markers.graded.bands`).
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.state_map.graded import Array, GradedStateMap
from spikingtac.types import EventPacket

# Standard deviation of the pixels' steps, as a share of a step (Lichtsteiner et al. 2008,
# doi:10.1109/JSSC.2007.914337: 2.1 % contrast at a threshold of 15 %).
THRESHOLD_MISMATCH = 0.12

# A pixel that has swung fully fired last so many steps before the end, on the average.
END_SHARE = 0.5


class BandStateMap(GradedStateMap):
    """Levels of the last events, from 0 (ground) to 1 (marker).

    Attributes:
        padded: As in the graded map: expected levels, half a step beyond the last event.
        variance: ``(height, width)`` float32 variance of :attr:`memory`, shares of a swing squared.
        fired: ``(height, width)`` int64 turn in which each pixel fired last.
        turn: The present turn; whoever has read what fired in it adds one.
    """

    def __init__(
        self,
        start: NDArray[np.float32],
        step_on: NDArray[np.float32],
        step_off: NDArray[np.float32],
        *,
        dark_markers: bool = False,
    ) -> None:
        """Begin with a painted map; the pixels' last contact is not known."""
        super().__init__(start, step_on, step_off, dark_markers=dark_markers)
        self._first_variance = ((self._step_on + self._step_off) ** 2 / 12.0).astype(np.float32)
        self._middle = (0.5 * (self._step_off - self._step_on)).astype(np.float32)
        self.variance, self.fired = np.empty_like(self._start), np.empty(start.shape, np.int64)
        self.reset()

    def absorb(self, packet: EventPacket) -> None:
        """Add every event of a packet.

        Raises:
            ConfigError: The packet comes from a sensor of another size.
        """
        packet.require_map(self._start.shape)
        maps = self.memory, self.values, self.variance, self.fired
        columns = packet.x, packet.y, packet.p
        _fire_kernel(maps, columns, self.signed_steps, self.dark_markers, self.turn)

    def restore(self, pixels: NDArray[np.bool_]) -> None:
        """Paint ``(height, width)`` pixels as in the beginning; their last contact is not known."""
        super().restore(pixels)
        self.memory[pixels] += self._middle[pixels]
        self.variance[pixels] = self._first_variance[pixels]
        self.fired[pixels] = 0

    def reset(self) -> None:
        """Go back to the map that the object was made with."""
        super().reset()
        self.memory[:] += self._middle  # into the middle of the band, as after an unknown contact
        self.variance[:] = self._first_variance
        self.fired[:] = 0
        self.turn = 1


@njit(cache=True, nogil=True)
def _fire_kernel(
    maps: tuple[Array, Array, Array, Array],
    events: tuple[Array, Array, Array],
    signed_steps: Array,
    dark_markers: bool,
    turn: int,
) -> None:  # pragma: no cover - compiled
    """Move each pixel that fired by its step, between the ends of a full swing."""
    memory, level, variance, fired = maps
    x, y, p = events
    half, one = np.float32(END_SHARE), np.float32(1.0)
    mismatch = np.float32(THRESHOLD_MISMATCH**2)
    for i in range(x.size):
        row, column = y[i], x[i]
        fall, rise = signed_steps[row, column, 0], signed_steps[row, column, 1]
        step = rise if p[i] != dark_markers else fall
        value = memory[row, column] + step
        value = min(max(value, -half * fall), one - half * rise)
        memory[row, column] = value
        level[row, column] = value + half * step
        variance[row, column] += mismatch * step * step
        fired[row, column] = turn
