"""Readings of touches for arms of different repeatability.

The twin's arm reports without its repeatability error. A reading is the reported position plus
``sigma`` times a normal draw, which is stored with it; the same touch can thus be read again as an
arm of another repeatability would report it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from spikingtac.robot.prober import ArmProber, Touched
from spikingtac.types import FloatArray

SIGMAS_MM = {"rep028": 0.028, "rep008": 0.008}
"""Case prefix -> repeatability of one reading per axis, mm (contract.md)."""
PLANNING_MM = SIGMAS_MM["rep028"]
"""Repeatability of the readings on which the searches plan, mm."""


class RecordingProber:
    """A prober that adds the arm's repeatability to the readings, and stores readings and draws.

    Args:
        prober: Makes the touches.
        seed: Seed of the draws.

    Attributes:
        stored: The touches without repeatability, as JSON holds them.
        returned: The touches that the caller received, in the same order.
    """

    def __init__(self, prober: ArmProber, seed: Sequence[int]) -> None:
        self.stored: list[dict[str, Any]] = []
        self.returned: list[Touched] = []
        self._prober = prober
        self._rng = np.random.default_rng(seed)

    def place_mm(self) -> FloatArray:
        """Return the position of the probe ``(2,)``, mm."""
        return self._prober.place_mm()

    def touch(self, start_mm: FloatArray, direction: FloatArray) -> Touched:
        """Touch, and return the reading with the repeatability :data:`PLANNING_MM`."""
        before = self._prober.touches
        touched = self._prober.touch(start_mm, direction)
        stored = {
            "start_mm": touched.start_mm.tolist(),
            "direction": touched.direction.tolist(),
            "reading_mm": touched.reading_mm.tolist(),
            "draw": self._rng.standard_normal(2).tolist(),
            "presses": self._prober.touches - before,
        }
        self.stored.append(stored)
        self.returned.append(touched_of(stored, PLANNING_MM))
        return self.returned[-1]

    def numbers(self, touches: Sequence[Touched]) -> list[int]:
        """Return the indices of some touches among the stored ones."""
        return [k for one in touches for k, other in enumerate(self.returned) if other is one]


def touched_of(stored: dict[str, Any], sigma_mm: float) -> Touched:
    """Return a stored touch as an arm with a repeatability of ``sigma_mm`` would report it."""
    reading = np.array(stored["reading_mm"]) + sigma_mm * np.array(stored["draw"])
    return Touched(np.array(stored["start_mm"]), np.array(stored["direction"]), reading)
