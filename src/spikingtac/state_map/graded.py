"""The graded state map: it integrates brightness where the paper's map remembers a sign.

Every ON event raises its pixel by a step, every OFF event lowers it, clipped to [0, 1]. The step is
the share of the full swing between ground and marker that one event stands for; clipping at both
ends anchors the sum, so that noise mostly cancels and leak saturates. Between two events the true
level lies on the far side of the last crossing: half a step in the direction of the last polarity
is its expectation, which removes most of the hysteresis, also at rest. Ours; the reason against
the paper's Eq. 1 is measured in ``docs/explanation/paper-map.md``.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.kernels import kernel
from spikingtac.types import EventPacket

Array = NDArray[Any]  # Array of a compiled function, whose compiler knows its type.

# Margin around the sensor in the padded arrays, so that fits at the border need no bounds.
PAD_PX = 24

# Level of the margin: so far from any marker that a robust fit gives it no weight.
OUTSIDE_LEVEL = np.float32(-1.0e4)

# Steps by which a level is expected beyond the last crossing.
HALF_STEP = 0.5

# One event's share of the swing at contrast 6 and threshold 0.25: 0.25 / ln 6.
STEP_DEFAULT = 0.139

# What an event finds at its pixel, in one line of the processor's memory (in arrays of their own
# they take twice as long): the clipped sum of its steps; the falling step (negative) and the rising
# one; which marker it lies around; and what :class:`~spikingtac.events.hot_pixels.HotPixelWatch`
# counts.
PIXEL = np.dtype(
    [
        *((name, np.float32) for name in ("level", "off", "on")),
        ("around", np.uint16),
        *((name, np.uint8) for name in ("events", "alone")),
    ]
)


class GradedStateMap:
    """Brightness per pixel, from 0 (ground) to 1 (marker), kept up to date by events.

    Attributes:
        padded: ``(height + 2 PAD_PX, width + 2 PAD_PX)`` float32 levels with the margin at
            OUTSIDE_LEVEL; fits read it, the leak moves it.
        pixels: ``(height, width)`` of :data:`PIXEL`; a map keeps levels and steps alone.
        events_kept: Events that arrive over events that the calibration saw; above 0. Of n events
            per swing only ``n * events_kept`` arrive, and a step is 1 / (n + 1): the one more is
            the dead band in which a pixel reverses without an event. So steps grow with loss.
        dark_markers: Whether markers are darker than the ground: polarities swap.
    """

    def __init__(
        self,
        start: NDArray[np.float32],
        step_on: NDArray[np.float32] | float = STEP_DEFAULT,
        step_off: NDArray[np.float32] | float = STEP_DEFAULT,
        *,
        dark_markers: bool = False,
        ahead: float = HALF_STEP,
    ) -> None:
        """Begin with a painted map, or with zeros for an unknown skin.

        Args:
            start: ``(height, width)`` levels to begin with.
            step_on: ``(height, width)`` or one share of the swing per ON event.
            step_off: The same per OFF event.
            dark_markers: True where markers are darker than the ground: polarities swap.
            ahead: Steps from an event's own level to the level to expect after it. With 0 levels
                are those of the last events, and end half a step short of a full swing.

        Raises:
            ConfigError: A step has another shape than the map, or lies outside of (0, 1].
        """
        self._start = start.astype(np.float32)
        self.dark_markers = dark_markers
        self.ahead = ahead
        self.events_kept = 1.0
        on, off = self._checked_steps("step_on", step_on), self._checked_steps("step_off", step_off)
        self.pixels = np.zeros(start.shape, PIXEL)
        self.pixels["off"], self.pixels["on"] = -off, on
        # A level of a last event lies in the middle of its band before the first one.
        self._start_level = (self._start + (HALF_STEP - ahead) * (off - on)).astype(np.float32)
        self.pixels["level"] = self._start_level
        height, width = start.shape
        self.padded = np.full((height + 2 * PAD_PX, width + 2 * PAD_PX), OUTSIDE_LEVEL)
        self.values[:] = self._start

    @property
    def values(self) -> NDArray[np.float32]:
        """``(height, width)`` expected levels; a view that the next packet changes."""
        # Cut anew each time: a view that is stored would be torn off by a deep copy.
        return self.padded[PAD_PX:-PAD_PX, PAD_PX:-PAD_PX]

    def absorb(self, packet: EventPacket) -> None:
        """Add every event of a packet.

        Raises:
            ConfigError: The packet comes from a sensor of another size.
        """
        packet.require_map(self._start.shape)
        maps = self.pixels, self.values
        settings = self.dark_markers, self.ahead, self.events_kept
        _integrate_kernel(*maps, packet.x, packet.y, packet.p, *settings)

    def restore(self, pixels: NDArray[np.bool_]) -> None:
        """Paint ``(height, width)`` pixels as in the beginning."""
        self.pixels["level"][pixels] = self._start_level[pixels]
        self.values[pixels] = self._start[pixels]

    def reset(self) -> None:
        """Go back to the map that the object was made with."""
        self.pixels["level"] = self._start_level
        self.values[:] = self._start
        self.events_kept = 1.0

    def _checked_steps(self, name: str, step: NDArray[np.float32] | float) -> NDArray[np.float32]:
        if np.shape(step) not in ((), self._start.shape):
            raise ConfigError(f"{name} has shape {np.shape(step)}, the map is {self._start.shape}")
        steps = np.full_like(self._start, step)
        if not ((steps > 0.0) & (steps <= 1.0)).all():
            raise ConfigError(
                f"{name} reaches from {steps.min():g} to {steps.max():g}; a step is the share of "
                "the full swing that one event stands for, above 0 and at most 1"
            )
        return steps


@kernel(forceinline=True)
def integrate_event_kernel(
    pixel: Any, rises: bool, ahead: float, kept: float
) -> float:  # pragma: no cover - compiled
    """Add an event's signed step to its pixel's sum; return the level to expect from then on."""
    zero, half, one = np.float32(0.0), np.float32(HALF_STEP), np.float32(1.0)
    share, beyond = np.float32(kept), np.float32(ahead)
    calibrated = pixel.on if rises else pixel.off
    step = calibrated / (share + (one - share) * abs(calibrated))
    short = half - beyond
    low, high = -short * pixel.off, one - short * pixel.on
    level = min(max(pixel.level + step, low), high)
    pixel.level = level
    return min(max(level + beyond * step, zero), one)


@kernel()
def _integrate_kernel(
    pixels: Array, level: Array, x: Array, y: Array, p: Array, dark_markers: bool, ahead: float,
    kept: float,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Add the step of each event. Arguments are plain: a tuple would cost a us at each call."""
    for i in range(x.size):
        pixel = pixels[y[i], x[i]]
        level[y[i], x[i]] = integrate_event_kernel(pixel, p[i] != dark_markers, ahead, kept)
