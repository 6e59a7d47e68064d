"""The paper's state map: each pixel remembers the polarity of its last event (Eq. 1).

What it cannot do: a marker's edge crosses several contrast thresholds, the first ON event of the
leading edge already paints and the first OFF event of the trailing edge already erases, so that the
painted disc runs ahead of the marker and stays there when the motion stops. Nothing fades either:
noise paints the ground until it is as white as black. ``docs/explanation/errata.md``
has figures.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.errors import ConfigError, RecordingError
from spikingtac.types import EventPacket


class BinaryStateMap:
    """The map M of Eq. 1: an ON event paints its pixel white, an OFF event black.

    Example:
        >>> import numpy as np
        >>> from spikingtac.types import EventPacket
        >>> state_map = BinaryStateMap((4, 3))
        >>> one = np.array([2], np.uint16)
        >>> state_map.absorb(EventPacket(one, one, one > 0, np.array([5]), 0, 10, (4, 3)))
        >>> float(state_map.values[2, 2])
        1.0
    """

    def __init__(
        self,
        size: tuple[int, int],
        start: NDArray[np.float32] | None = None,
        *,
        dark_markers: bool = False,
    ) -> None:
        """Begin with an empty map, or with a painted one (:mod:`spikingtac.state_map.paint`).

        Args:
            size: ``(width, height)``, px.
            start: ``(height, width)`` map to begin with; the paper begins with the null matrix.
            dark_markers: True where markers are darker than the ground: polarities swap.

        Raises:
            ConfigError: The start has another shape than the sensor.
        """
        shape = (size[1], size[0])
        if start is not None and start.shape != shape:
            raise ConfigError(
                f"the painted start has shape {start.shape}, the sensor asks for {shape} "
                "(height, width); paint it with the size of the recording"
            )
        self._start = np.zeros(shape, np.float32) if start is None else start.astype(np.float32)
        self._values = self._start.copy()
        self._dark_markers = dark_markers

    @property
    def values(self) -> NDArray[np.float32]:
        """``(height, width)`` of 0 and 1; a view that the next packet changes."""
        return self._values

    def absorb(self, packet: EventPacket) -> None:
        """Paint every event of a packet, which is trusted to lie inside its ``size``.

        Raises:
            ConfigError: The packet comes from a sensor of another size.
        """
        packet.require_map(self._values.shape)
        _paint_events_kernel(self._values, packet.x, packet.y, packet.p, self._dark_markers)

    def absorb_counted(self, packet: EventPacket, period_us: int) -> NDArray[np.int64]:
        """Check a packet, paint it, and count its events per window.

        Perception needs the counts and tracking the map (paper section V-B); this is for a driver
        that takes events from an unchecked origin.

        Args:
            packet: Events; the first window begins at ``packet.t_start_us``.
            period_us: Length of a window, us.

        Returns:
            ``int64[k]`` events in each window of the packet's span, empty windows included.

        Raises:
            ConfigError: The period is not positive.
            RecordingError: An event lies outside of the sensor or of the packet's span, or goes
                back in time; nothing is painted then.
        """
        if period_us < 1:
            raise ConfigError(f"period_us is {period_us}, it must be at least 1")
        unfit = first_unfit_event(packet)
        if unfit is not None:
            raise RecordingError(
                f"event {unfit} (x {packet.x[unfit]}, y {packet.y[unfit]}, t {packet.t[unfit]} us) "
                f"lies outside of the {packet.size[0]}x{packet.size[1]} sensor or of "
                f"[{packet.t_start_us}, {packet.t_end_us}) us, or goes back in time; "
                "read the recording with open_events, which mends or refuses such events"
            )
        self.absorb(packet)
        edges_us = np.arange(packet.t_start_us, packet.t_end_us + period_us, period_us)
        return np.diff(np.searchsorted(packet.t, edges_us))

    def repaint(self, white: NDArray[np.bool_]) -> None:
        """Replace the map, by ``(height, width)`` which pixels show a marker."""
        self._values[:] = white

    def reset(self) -> None:
        """Go back to the map that the object was made with."""
        self._values[:] = self._start


def first_unfit_event(packet: EventPacket) -> int | None:
    """Return the index of the first event that breaks the packet's invariants, or None.

    The invariants are those of :class:`~spikingtac.types.EventPacket`: inside the sensor, inside
    the span, never back in time.
    """
    x, y, t = packet.x, packet.y, packet.t
    in_span = len(t) == 0 or (t[0] >= packet.t_start_us and t[-1] < packet.t_end_us)
    if in_span and _all_fit_kernel(x, y, t, packet.size):
        return None
    unfit = (x >= packet.size[0]) | (y >= packet.size[1])
    unfit |= (t < packet.t_start_us) | (t >= packet.t_end_us)
    unfit[1:] |= np.diff(t) < 0
    return int(np.argmax(unfit))


@njit(cache=True)
def _paint_events_kernel(
    values: NDArray[np.float32],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    dark_markers: bool,
) -> None:
    for i in range(x.size):
        values[y[i], x[i]] = p[i] != dark_markers


@njit(cache=True)
def _all_fit_kernel(
    x: NDArray[np.uint16], y: NDArray[np.uint16], t: NDArray[np.int64], size: tuple[int, int]
) -> bool:
    # Three plain reductions instead of one loop with exits: LLVM turns each into vector code,
    # which with the painting after it is 1.7 times faster than checking while painting.
    largest_x = np.uint16(0)
    for i in range(x.size):
        largest_x = max(largest_x, x[i])
    largest_y = np.uint16(0)
    for i in range(y.size):
        largest_y = max(largest_y, y[i])
    any_negative = np.int64(0)
    for i in range(1, t.size):
        any_negative |= t[i] - t[i - 1]
    return bool(largest_x < size[0] and largest_y < size[1] and any_negative >= 0)
