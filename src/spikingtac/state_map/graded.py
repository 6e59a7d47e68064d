"""The graded state map: each pixel's brightness level, integrated from its events.

Every ON event raises its pixel by a step, every OFF event lowers it, clipped to [0, 1]. A step is
the share of the full swing between ground and marker that one event stands for. Clipping at both
ends anchors the sum, so that noise mostly cancels and leak saturates. Until the next event the true
level lies beyond the threshold that was crossed last: on average half a step in the direction of
the last polarity. Adding this half step removes most of the hysteresis, also at rest. The paper's
map (Eq. 1) keeps the last polarity only; ``docs/explanation/paper-map.md`` compares both.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.kernels import kernel
from spikingtac.types import EventPacket

Array = NDArray[Any]  # Array of a compiled function, whose compiler knows its type.

# Margin around the sensor in the padded arrays, so that fits at the border need no bounds. It holds
# grown discs of up to 90 px.
PAD_PX = 128

# Level of the margin: so far from any marker that a robust fit gives it no weight.
OUTSIDE_LEVEL = np.float32(-1.0e4)

# Mean distance of a level beyond the threshold that it crossed last, in steps.
HALF_STEP = 0.5

# One event's share of the swing at contrast 6 and threshold 0.25: 0.25 / ln 6.
STEP_DEFAULT = 0.139

# State of a pixel, in one line of the processor's cache (separate arrays take twice as long): the
# clipped sum of its steps; the step of an OFF event (negative) and of an ON event; the number of
# the marker in whose gate it lies; the counters of
# :class:`~spikingtac.events.hot_pixels.HotPixelWatch`; the time of its last event, us, in 32 bits,
# and its direction: 1 down, 2 up, 0 before the first.
PIXEL = np.dtype(
    [
        *((name, np.float32) for name in ("level", "off", "on")),
        ("marker", np.uint16),
        *((name, np.uint8) for name in ("events", "alone")),
        *((name, np.uint32) for name in ("last_us", "direction")),
    ]
)


class GradedStateMap:
    """Brightness level of each pixel, from 0 (ground) to 1 (marker), integrated from events.

    Attributes:
        padded: ``(height + 2 PAD_PX, width + 2 PAD_PX)`` float32 expected levels, with a margin of
            OUTSIDE_LEVEL; fits read them, the leak changes them.
        pixels: ``(height, width)`` of :data:`PIXEL`; the map uses levels and steps only.
        arrival_ratio: Events that arrive over events that the calibration saw; above 0. Of n events
            per swing only ``n * arrival_ratio`` arrive, and a step is 1 / (n + 1): the 1 stands for
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
        lead_steps: float = HALF_STEP,
    ) -> None:
        """Begin with a painted map, or with zeros for an unknown skin.

        Args:
            start: ``(height, width)`` levels to begin with.
            step_on: ``(height, width)`` or one share of the swing per ON event.
            step_off: The same per OFF event.
            dark_markers: True where markers are darker than the ground: polarities swap.
            lead_steps: Steps from the level of an event's threshold to the level expected after the
                event. With 0 the map holds the levels of the last events, and these end half a step
                short of a full swing.

        Raises:
            ConfigError: A step has another shape than the map, or lies outside of (0, 1].
        """
        self._start = start.astype(np.float32)
        self.dark_markers = dark_markers
        self.lead_steps = lead_steps
        self.arrival_ratio = 1.0
        on, off = self._checked_steps("step_on", step_on), self._checked_steps("step_off", step_off)
        self.pixels = np.zeros(start.shape, PIXEL)
        self.pixels["off"], self.pixels["on"] = -off, on
        # Before the first event the start level lies in the middle of the pixel's dead band.
        self._start_level = (self._start + (HALF_STEP - lead_steps) * (off - on)).astype(np.float32)
        self.pixels["level"] = self._start_level
        height, width = start.shape
        self.padded = np.full((height + 2 * PAD_PX, width + 2 * PAD_PX), OUTSIDE_LEVEL)
        self.values[:] = self._start

    @property
    def values(self) -> NDArray[np.float32]:
        """``(height, width)`` expected levels; a view that the next packet changes."""
        # Sliced at each access: a deep copy would separate a stored view from its array.
        return self.padded[PAD_PX:-PAD_PX, PAD_PX:-PAD_PX]

    def absorb(self, packet: EventPacket) -> None:
        """Add every event of a packet.

        Raises:
            ConfigError: The packet comes from a sensor of another size.
        """
        packet.require_map(self._start.shape)
        maps = self.pixels, self.values
        settings = self.dark_markers, self.lead_steps, self.arrival_ratio
        _integrate_kernel(*maps, packet.x, packet.y, packet.p, *settings)

    def restore(self, pixels: NDArray[np.bool_]) -> None:
        """Set ``(height, width)`` pixels to their levels at the start."""
        self.pixels["level"][pixels] = self._start_level[pixels]
        self.values[pixels] = self._start[pixels]

    def reset(self) -> None:
        """Go back to the map that the object was made with."""
        self.pixels["level"], self.pixels["direction"] = self._start_level, 0
        self.values[:] = self._start
        self.arrival_ratio = 1.0

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
    pixel: Any, rises: bool, lead_steps: float, arrival_ratio: float
) -> float:  # pragma: no cover - compiled
    """Add an event's signed step to its pixel's sum; return the level expected after the event."""
    zero, half, one = np.float32(0.0), np.float32(HALF_STEP), np.float32(1.0)
    ratio, lead = np.float32(arrival_ratio), np.float32(lead_steps)
    calibrated = pixel.on if rises else pixel.off
    step = calibrated / (ratio + (one - ratio) * abs(calibrated))
    short = half - lead
    low, high = -short * pixel.off, one - short * pixel.on
    level = min(max(pixel.level + step, low), high)
    pixel.level = level
    return min(max(level + lead * step, zero), one)


@kernel()
def _integrate_kernel(
    pixels: Array, level: Array, x: Array, y: Array, p: Array, dark_markers: bool, lead: float,
    ratio: float,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Add the step of each event. Arguments are plain, since a tuple costs a us at each call."""
    for i in range(x.size):
        pixel = pixels[y[i], x[i]]
        level[y[i], x[i]] = integrate_event_kernel(pixel, p[i] != dark_markers, lead, ratio)
