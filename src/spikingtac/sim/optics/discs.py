"""The painted discs of a skin: fabrication tolerances, broken and missing discs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, slots=True)
class DiscConfig:
    """Size and tolerances of the markers, and which are damaged.

    Attributes:
        radius_mm: Mean radius, mm (the paper gives none; 0.8 to 1.0 mm across is usual).
        radius_sigma_mm: Standard deviation of the radius from disc to disc, mm (assumed: 0.25 px).
        position_sigma_mm: Standard deviation of each coordinate about the grid, mm (assumed: 0.8
            px).
        broken: Indices of markers of which only ``broken_share`` of the width remains.
        broken_share: Fraction of the diameter that a broken marker keeps, 0 to 1.
        missing: Indices of missing markers.
    """

    radius_mm: float = 0.45
    radius_sigma_mm: float = 0.016
    position_sigma_mm: float = 0.05
    broken: tuple[int, ...] = ()
    broken_share: float = 0.5
    missing: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not self.radius_mm > 0 or self.radius_sigma_mm < 0 or self.position_sigma_mm < 0:
            raise ValueError("radius_mm must be positive and the spreads must not be negative")
        if not 0 < self.broken_share <= 1:
            raise ValueError(f"broken_share is {self.broken_share}, it must lie in (0, 1]")


@dataclass(frozen=True, slots=True)
class Discs:
    """The discs of one skin.

    Attributes:
        radius_mm: ``(m,)`` radii, mm; 0 where a marker is missing.
        offset_mm: ``(m, 2)`` offsets from the nominal places, in the rest frame, mm.
        chord: ``(m, 3)`` unit normal and distance (mm) of the line beyond which the paint is
            missing.
    """

    radius_mm: NDArray[np.float64]
    offset_mm: NDArray[np.float64]
    chord: NDArray[np.float64]

    def chord_px(self, px_per_mm: float) -> NDArray[np.float64] | None:
        """Return the chords in px as in :class:`MarkerImage`, or None if all discs are whole."""
        if np.isinf(self.chord[:, 2]).all():
            return None
        return self.chord * np.array([1.0, 1.0, px_per_mm])


def draw_discs(config: DiscConfig, markers: int, seed: int) -> Discs:
    """Draw the discs of a skin with ``markers`` markers.

    The tolerances of a marker do not depend on which other markers are broken or missing.

    Args:
        config: Sizes and damage.
        markers: Number of markers.
        seed: Seed of the tolerances.

    Raises:
        ValueError: A broken or missing index is not a marker.
    """
    for index in (*config.broken, *config.missing):
        if not 0 <= index < markers:
            raise ValueError(f"marker {index} does not exist, valid are 0 to {markers - 1}")
    rng = np.random.default_rng([seed, markers])
    spread = rng.standard_normal(markers).clip(-3, 3)
    radius_mm = np.maximum(config.radius_mm + config.radius_sigma_mm * spread, 0.0)
    offset_mm = config.position_sigma_mm * rng.standard_normal((markers, 2)).clip(-3, 3)
    angle = rng.uniform(0, 2 * np.pi, markers)
    chord = np.stack([np.cos(angle), np.sin(angle), np.full(markers, np.inf)], axis=1)
    broken = list(config.broken)
    chord[broken, 2] = (2 * config.broken_share - 1) * radius_mm[broken]
    radius_mm[list(config.missing)] = 0.0
    return Discs(radius_mm=radius_mm, offset_mm=offset_mm, chord=chord)
