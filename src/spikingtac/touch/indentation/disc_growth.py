"""How much every disc has grown, from events and from where the markers are.

An event moves its pixel by a step of brightness. Summed over a disc's surroundings that is the
change of its area, whatever its shift: what is ON ahead of a moving disc is OFF behind it. The
levels are those of :mod:`spikingtac.state_map.graded`, clipped, so that noise cancels where a rim
sweeps a pixel wholly. Only a ring about the rim is summed: the disc within and the ground without
are known. What noise adds to a ring at rest is taken off, as a rate that wears off; and at rest the
outlines return to the calibrated ones, and their areas are the zero.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.hot_pixels import HotPixelFilter
from spikingtac.state_map.graded import GradedStateMap
from spikingtac.touch.indentation.disc_areas import (
    INSIDE_PX,
    OUTSIDE_PX,
    Levels,
    disc_areas_kernel,
    disc_neighbours,
    return_outlines_kernel,
)
from spikingtac.touch.indentation.resting_discs import RestingDiscs
from spikingtac.types import EventPacket

Field = NDArray[np.float64]

US_PER_S = 1e6
WIPED_PX = 3.0
"""Width of the ground around a ring that is wiped, px (ours: no rim goes farther between two
measurements but in a sudden release)."""
LARGEST_GROWTH = 0.4
"""Growth and shrinking that the ring follows (ours: twice the most of the twin's scenes)."""
UNNOTICED_US = 100_000
"""Time for which a touch may last before it is noticed, us (ours: 15 to 70 ms in the ten scenes):
what looked like rest in it tells neither zero nor drift."""
RING_PX = 3.0
"""Width of the part of a rim whose pixels lie between disc and ground, px."""


@dataclass(frozen=True, kw_only=True)
class DiscGrowthConfig:
    """How growth is measured. All values are ours, chosen on the training scenes of the twin.

    Attributes:
        outline_return_per_s: Rate at which the edges of resting discs return to their calibrated
            levels, 1/s.
        zero_s: Time constant of the resting areas, s.
        drift_s: Time constant of the rate at which noise changes a resting area, s.
        settle_s: Time constant with which that change wears off in a touch, s: levels end at 0
            and 1.
        level_sigma: Error of a pixel between disc and ground, in steps.
        drift_share: Share of the drift taken off that is its error.
        growth_share: Share of the growth that is its error: rims are no circles.
    """

    outline_return_per_s: float = 3.0
    zero_s: float = 0.2
    drift_s: float = 2.0
    settle_s: float = 1.0
    level_sigma: float = 1.05
    drift_share: float = 1.0
    growth_share: float = 0.3

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} is {getattr(self, name)}, it must be positive")


@dataclass(frozen=True, slots=True)
class DiscGrowth:
    """The growth of the discs at one time.

    Attributes:
        t_us: The time, us.
        growth: ``(m,)`` growth of each disc's radius, as a share of the resting one.
        sigma: ``(m,)`` one standard deviation of it.
    """

    t_us: int
    growth: Field
    sigma: Field


class DiscGrowthGauge:
    """Follows the areas of the discs, causally.

    Example:
        >>> gauge = DiscGrowthGauge(calibration)  # doctest: +SKIP
        >>> gauge.absorb(packet)  # doctest: +SKIP
        >>> gauge.measure(frame.t_us, frame.detected_px, resting=False).growth  # doctest: +SKIP
    """

    def __init__(self, calibration: Calibration, config: DiscGrowthConfig | None = None) -> None:
        """Begin with the discs as they were calibrated.

        Args:
            calibration: Where the markers rest, and how they look.
            config: How growth is measured.

        Raises:
            ConfigError: The calibration knows no contrast, edge or steps.
        """
        self._calibration, self._config = calibration, config or DiscGrowthConfig()
        self._hot = HotPixelFilter(calibration.hot_px, calibration.size)
        self._discs = RestingDiscs.of(calibration)
        self._half = self._discs.radius_px + self._discs.offset_px
        self._near = disc_neighbours(calibration.reference_px)
        on, off = self._discs.steps
        self._step = 0.5 * float(on.mean() + off.mean())
        self.reset()

    def reset(self) -> None:
        """Forget everything: the markers are at the calibrated rest."""
        known = self._calibration
        blank = np.zeros(known.size[::-1], np.float32)
        dark = known.polarity == "dark"
        self._map = GradedStateMap(blank, *self._discs.steps, dark_markers=dark)
        self._growth = np.zeros(len(known.reference_px))
        self._return_outlines(known.reference_px, 1.0)
        self._zero = self._last = self._areas(known.reference_px)
        self._last_us: int | None = None
        self._drift_px2_s = self._drift_weight_s = self._held_s = 0.0
        self._rests: deque[tuple[int, Field, float]] = deque()

    def absorb(self, packet: EventPacket) -> None:
        """Take in events.

        Raises:
            ConfigError: They are of another sensor.
        """
        self._map.absorb(self._hot.kept(packet))

    def measure(self, t_us: int, place_px: Field, *, resting: bool) -> DiscGrowth:
        """Return the growth at a time, the end of what was absorbed.

        Args:
            t_us: The time, us.
            place_px: ``(m, 2)`` where the markers are, px.
            resting: True where nothing touches: the discs have their resting size.
        """
        elapsed_s = 0.0 if self._last_us is None else (t_us - self._last_us) / US_PER_S
        self._last_us = t_us
        place = np.ascontiguousarray(place_px, np.float64)
        area = self._areas(place)
        if resting:
            self._rest(area, place, elapsed_s)
            self._remember(t_us)
        else:
            if self._rests:
                _, self._zero, self._drift_px2_s = self._rests[0]
                self._rests.clear()
            self._held_s += elapsed_s
        settle_s = self._config.settle_s
        drift = self._drift_px2_s * settle_s * float(-np.expm1(-self._held_s / settle_s))
        return self._told(t_us, area - self._zero - drift, drift)

    def _rest(self, area: Field, place: Field, elapsed_s: float) -> None:
        """Learn the drift, let outlines return, and let the zero follow."""
        config = self._config
        if elapsed_s > 0.0 and self._held_s == 0.0:
            kept = np.exp(-elapsed_s / config.drift_s)
            self._drift_weight_s = self._drift_weight_s * kept + elapsed_s
            rate = float(np.mean(area - self._last)) / elapsed_s
            share = elapsed_s / self._drift_weight_s
            self._drift_px2_s += share * (rate - self._drift_px2_s)
        self._held_s = 0.0
        self._return_outlines(place, float(-np.expm1(-config.outline_return_per_s * elapsed_s)))
        self._last = self._areas(place)
        share = -np.expm1(-elapsed_s / config.zero_s)
        self._zero = self._zero + share * (self._last - self._zero)

    def _remember(self, t_us: int) -> None:
        """Keep zero and drift for the time in which a touch may go unnoticed."""
        self._rests.append((t_us, self._zero, self._drift_px2_s))
        while len(self._rests) > 1 and self._rests[1][0] <= t_us - UNNOTICED_US:
            self._rests.popleft()

    def _areas(self, place: Field) -> Field:
        """Return the sums of the levels ``(m,)``; the rings follow the size of the discs."""
        area = np.empty(len(place))
        bounds = _bounds(self._discs.radius_px * (1.0 + self._growth) + self._discs.offset_px)
        disc_areas_kernel(self._maps(), place, bounds, self._near, area)
        return area

    def _return_outlines(self, place: Field, share: float) -> None:
        profiles, bounds = self._discs.profiles, _bounds(self._half)
        return_outlines_kernel(self._maps(), place, bounds, self._near, profiles, share)

    def _maps(self) -> tuple[Levels, Levels]:
        return self._map.memory, self._map.values

    def _told(self, t_us: int, grown_px2: Field, drift_px2: float) -> DiscGrowth:
        """Return the growth for areas ``(m,)`` over the zero: pi (r + offset)^2 changes with r."""
        config, radius, half = self._config, self._discs.radius_px, self._half
        square = np.maximum(half**2 + grown_px2 / np.pi, 0.0)
        growth = (np.sqrt(square) - half) / radius
        self._growth = np.clip(growth, -LARGEST_GROWTH, LARGEST_GROWTH)
        pixels = 2.0 * np.pi * half * RING_PX
        variance = (config.level_sigma * self._step) ** 2 * pixels
        variance = variance + (config.drift_share * drift_px2) ** 2
        sigma = np.sqrt(variance) / (2.0 * np.pi * radius * half)
        return DiscGrowth(t_us, growth, np.hypot(sigma, config.growth_share * growth))


def _bounds(edge_px: Field) -> Field:
    """Return ``(m, 3)`` the bounds of disc, ring and wiped ground for edges ``(m,)``, px."""
    rim = edge_px + OUTSIDE_PX
    return np.column_stack([np.maximum(edge_px - INSIDE_PX, 0.0), rim, rim + WIPED_PX])
