"""The elastic part of a displacement: what creep has added is taken off.

Under a constant force a soft skin goes on moving, so a displacement alone overstates an old force.
With retarded compliances J_i / J0 = c_i and times tau_i a displacement is
u = e + sum_i c_i q_i with tau_i dq_i/dt = e - q_i, where e is what the same forces would do at
once. The sums are kept per marker and e is solved for in each frame (a Kelvin chain, inverted;
R. M. Christensen, "Theory of Viscoelasticity", 1982, chapter 1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Field = NDArray[np.float64]

US_PER_S = 1e6


@dataclass(frozen=True, kw_only=True)
class CreepConfig:
    """Retarded compliances of a skin.

    Attributes:
        fractions: J_i / J0, none negative; empty for a skin that does not creep.
        times_s: Retardation times, s.
    """

    fractions: tuple[float, ...] = ()
    times_s: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if len(self.fractions) != len(self.times_s):
            raise ValueError("fractions and times_s must have equal length")
        if any(value < 0 for value in self.fractions) or any(not t > 0 for t in self.times_s):
            raise ValueError("fractions must not be negative, times_s must be positive")


class CreepMemory:
    """Follows the creep of one series, frame by frame."""

    def __init__(self, config: CreepConfig) -> None:
        """Start with a skin that has rested for long."""
        self._fractions = np.array(config.fractions)
        self._times_us = np.array(config.times_s) * US_PER_S
        self.reset()

    def reset(self) -> None:
        """Forget every load."""
        self._retarded: Field | None = None
        self._last_us: int | None = None

    def elastic(self, t_us: int, displacement: Field) -> Field:
        """Take in a displacement of any shape and return its elastic part.

        The load is taken as constant since the last frame.
        """
        if not len(self._fractions):
            return displacement
        flat = displacement.ravel()
        if self._retarded is None or self._last_us is None:
            self._retarded = np.zeros((len(self._fractions), flat.size))
            self._last_us = t_us
            return displacement
        elapsed_us = max(t_us - self._last_us, 0)
        self._last_us = t_us
        elastic = np.empty(flat.size)
        creep_kernel(flat, elapsed_us, self._fractions, self._times_us, self._retarded, elastic)
        return elastic.reshape(displacement.shape)


@njit(cache=True, nogil=True)
def creep_kernel(
    moved: Field,
    elapsed_us: int,
    fractions: Field,
    times_us: Field,
    retarded: Field,
    elastic: Field,
) -> None:
    """Solve u = e + sum c_i ((1 - g_i) q_i + g_i e) for e, and let the q_i follow it.

    Args:
        moved: ``(size,)`` u.
        elapsed_us: Time since the last frame, us.
        fractions: ``(k,)`` c_i.
        times_us: ``(k,)`` retardation times, us; g_i is one less the decay in the time elapsed.
        retarded: ``(k, size)`` q_i; moved.
        elastic: ``(size,)`` overwritten by e.
    """
    chain, stiffness = len(fractions), 1.0
    for i in range(len(moved)):
        elastic[i] = moved[i]
    for k in range(chain):
        gain = -np.expm1(-elapsed_us / times_us[k])
        stiffness += fractions[k] * gain
        kept = fractions[k] * (1.0 - gain)
        for i in range(len(moved)):
            elastic[i] -= kept * retarded[k, i]
    for i in range(len(moved)):
        elastic[i] /= stiffness
    for k in range(chain):
        gain = -np.expm1(-elapsed_us / times_us[k])
        for i in range(len(moved)):
            retarded[k, i] += gain * (elastic[i] - retarded[k, i])
