"""Oscillation after a sudden release: the first shear resonance of the layer.

The gel is quasi-static otherwise. Each marker follows its quasi-static place like a damped mass on
a spring. The step is exact for a place that moves evenly within it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from spikingtac.arrays import FloatArray

DENSITY_G_CM3 = 1.0
"""Density of silicone gel (manufacturers give 0.97 to 1.07)."""


@dataclass(frozen=True, kw_only=True)
class InertiaConfig:
    """The shear resonance.

    Attributes:
        enabled: True adds the oscillation. It shows only if the gel is stepped several times per
            period.
        damping: Damping ratio (ours: the middle of 0.1 to 0.2).
    """

    enabled: bool = False
    damping: float = 0.15

    def __post_init__(self) -> None:
        if not 0.0 < self.damping < 1.0:
            raise ValueError(f"damping is {self.damping}, it must lie between 0 and 1")


def shear_resonance_hz(shear_modulus_kpa: float, thickness_mm: float) -> float:
    """Return the first shear resonance c / 4h of a bonded layer, Hz (about 460 at 30 kPa, 3 mm)."""
    speed_m_s = math.sqrt(shear_modulus_kpa / DENSITY_G_CM3)  # sqrt(1e3 Pa / 1e3 kg/m3)
    return speed_m_s / (4e-3 * thickness_mm)


class Ringing:
    """Damped oscillators that follow moving places.

    Args:
        resonance_hz: Natural frequency, Hz.
        damping: Damping ratio.
        shape: Shape of the array of coordinates.
    """

    def __init__(self, resonance_hz: float, damping: float, shape: tuple[int, ...]) -> None:
        self._rate = 2.0 * math.pi * resonance_hz
        self._damping = damping
        self._place = np.zeros(shape)
        self._position = np.zeros(shape)
        self._velocity = np.zeros(shape)

    def step(self, dt_s: float, place_mm: FloatArray) -> FloatArray:
        """Advance by one step and return the positions of the oscillators, mm.

        Args:
            dt_s: Length of the step, s.
            place_mm: Quasi-static places at the end of the step, mm.
        """
        drift = (place_mm - self._place) / dt_s
        lag = 2.0 * self._damping / self._rate * drift
        offset = self._position - (self._place - lag)
        speed = self._velocity - drift
        sigma = self._damping * self._rate
        ringing = self._rate * math.sqrt(1.0 - self._damping**2)
        decay = math.exp(-sigma * dt_s)
        cosine, sine = decay * math.cos(ringing * dt_s), decay * math.sin(ringing * dt_s) / ringing
        self._position = place_mm - lag + offset * cosine + (speed + sigma * offset) * sine
        self._velocity = drift + speed * cosine - (sigma * speed + self._rate**2 * offset) * sine
        self._place = place_mm.copy()
        return self._position.copy()

    def reset(self) -> None:
        """Return to rest at zero."""
        for state in (self._place, self._position, self._velocity):
            state[:] = 0.0
