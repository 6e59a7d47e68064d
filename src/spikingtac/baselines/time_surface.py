"""A time surface over the whole sensor: recent events count fully, old ones fade to grey."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.types import EventPacket

GREY = np.float32(0.5)
"""Value of a pixel that has been silent for long."""


class TimeSurface:
    """The map (1 + p exp(-(t - t_last) / τ)) / 2 of each pixel's last event.

    Source: X. Lagorce et al., "HOTS: a hierarchy of event-based time-surfaces for pattern
    recognition", IEEE PAMI 39, 2017 (the exponential decay), signed by the polarity.

    Args:
        start: ``(height, width)`` of 0 and 1: the sensor before the first event, as if every pixel
            had just fired.
        decay_us: τ, us.
        dark_markers: True where markers are darker than the ground: polarities swap.
    """

    def __init__(
        self, start: NDArray[np.float32], decay_us: float, *, dark_markers: bool = False
    ) -> None:
        if not decay_us > 0.0:
            raise ConfigError(f"decay_us is {decay_us}, it must be positive")
        self._start, self._decay_us, self._dark = start, decay_us, dark_markers
        self._values = np.empty_like(start, np.float32)
        self.reset()

    @property
    def values(self) -> NDArray[np.float32]:
        """``(height, width)`` at the end of what was absorbed; a buffer that is written anew."""
        surface_kernel(self._last_us, self._side, self._now_us, self._decay_us, self._values)
        return self._values

    def absorb(self, packet: EventPacket) -> None:
        """Take in every event of the next stretch of time.

        Raises:
            ConfigError: The packet comes from a sensor of another size.
        """
        height, width = self._start.shape
        if packet.size != (width, height):
            raise ConfigError(
                f"events of a {packet.size[0]}x{packet.size[1]} sensor do not fit a map of "
                f"{width}x{height}; make the map with the size of the recording"
            )
        if self._now_us is None:
            self._last_us[:] = packet.t_start_us
        self._now_us = packet.t_end_us
        note_kernel(packet.x, packet.y, packet.p != self._dark, packet.t, self._last_us, self._side)

    def reset(self) -> None:
        """Go back to the start; time begins with the next packet."""
        self._now_us: int | None = None
        self._last_us = np.zeros(self._start.shape, np.int64)
        self._side = np.where(self._start > GREY, 1, -1).astype(np.int8)


@njit(cache=True)
def note_kernel(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    t: NDArray[np.int64],
    last_us: NDArray[np.int64],
    side: NDArray[np.int8],
) -> None:
    """Note time and polarity (+1 or -1) of each pixel's last event."""
    for i in range(len(x)):
        last_us[y[i], x[i]] = t[i]
        side[y[i], x[i]] = 1 if p[i] else -1


def surface_kernel(
    last_us: NDArray[np.int64],
    side: NDArray[np.int8],
    now_us: int | None,
    decay_us: float,
    values: NDArray[np.float32],
) -> None:
    """Write the surface at ``now_us``; None is the moment of the start."""
    age_us = 0.0 if now_us is None else (now_us - last_us).astype(np.float32)
    np.multiply(np.exp(-age_us / np.float32(decay_us)), GREY * side, out=values, casting="unsafe")
    values += GREY
