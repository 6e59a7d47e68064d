"""Readings of touches, by arms of different repeatability.

A reading is what the controller reports plus ``sigma`` times a draw that is kept beside it; the
searches plan on readings of the coarser arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.robot.prober import ArmProber, Touched

Vector = NDArray[np.float64]

SIGMAS_MM = {"rep028": 0.028, "rep008": 0.008}
"""Case prefix -> repeatability of one reading per axis, mm (contract.md)."""
PLANNING_MM = SIGMAS_MM["rep028"]
"""Repeatability of the readings that the searches plan on, mm."""


class RecordingProber:
    """Adds the arm's repeatability to readings, and keeps readings and draws.

    Args:
        prober: Who touches.
        seed: Of the draws.
    """

    def __init__(self, prober: ArmProber, seed: Sequence[int]) -> None:
        self.kept: list[dict[str, Any]] = []
        self.returned: list[Touched] = []
        self._prober = prober
        self._rng = np.random.default_rng(seed)

    def place_mm(self) -> Vector:
        """Return where the probe stands ``(2,)``, mm."""
        return self._prober.place_mm()

    def touch(self, start_mm: Vector, direction: Vector) -> Touched:
        """Touch, and read with the planning arm's repeatability."""
        before = self._prober.touches
        touched = self._prober.touch(start_mm, direction)
        kept = {
            "start_mm": touched.start_mm.tolist(),
            "direction": touched.direction.tolist(),
            "reading_mm": touched.reading_mm.tolist(),
            "draw": self._rng.standard_normal(2).tolist(),
            "presses": self._prober.touches - before,
        }
        self.kept.append(kept)
        self.returned.append(touched_of(kept, PLANNING_MM))
        return self.returned[-1]

    def numbers(self, touches: Sequence[Touched]) -> list[int]:
        """Return which of the kept touches these are."""
        return [k for one in touches for k, other in enumerate(self.returned) if other is one]


def touched_of(kept: dict[str, Any], sigma_mm: float) -> Touched:
    """Return a kept touch as an arm of some repeatability would have read it."""
    reading = np.array(kept["reading_mm"]) + sigma_mm * np.array(kept["draw"])
    return Touched(np.array(kept["start_mm"]), np.array(kept["direction"]), reading)
