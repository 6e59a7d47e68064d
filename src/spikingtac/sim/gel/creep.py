"""Creep of the gel: a Kelvin chain that is driven by the history of the traction.

A linear gel whose surface sticks to a body shows no creep, because its modulus cancels. Creep
appears as a residual displacement after unloading. The chain therefore takes the traction as its
input, not the displacement: u = J0 G q + sum w_i, tau_i dw_i/dt = J_i G q - w_i.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from spikingtac.arrays import FloatArray


@dataclass(frozen=True, kw_only=True)
class SpectrumConfig:
    """Retarded compliances of the gel (a Kelvin chain).

    Attributes:
        fractions: J_i / J0, the retarded compliances divided by the instantaneous one. The default
            values are a declared fit: no spectrum of the paper's gel is published.
        times_s: Retardation times tau_i, s.
    """

    fractions: tuple[float, ...] = (0.05, 0.05, 0.12)
    times_s: tuple[float, ...] = (0.02, 0.3, 8.0)

    def __post_init__(self) -> None:
        if len(self.fractions) != len(self.times_s):
            raise ValueError("fractions and times_s must have equal length")
        if any(fraction < 0 for fraction in self.fractions):
            raise ValueError(f"fractions are {self.fractions}, none may be negative")
        if any(not time > 0 for time in self.times_s):
            raise ValueError(f"times_s are {self.times_s}, all must be positive")


@njit(cache=True, nogil=True)
def creep_displacement_kernel(decay: FloatArray, retarded: FloatArray, out: FloatArray) -> None:
    """Fill ``out[c] = sum_i decay[i] retarded[i, c]``: ``(i,)``, ``(i, c)`` and ``(c,)``."""
    out[:] = 0.0
    for i in range(len(decay)):
        for cell in range(len(out)):
            out[cell] += decay[i] * retarded[i, cell]


@njit(cache=True, nogil=True)
def advance_creep_kernel(
    decay: FloatArray, gain: FloatArray, elastic: FloatArray, retarded: FloatArray
) -> None:
    """Set ``retarded[i, c]`` to ``decay[i] retarded[i, c] + gain[i] elastic[c]``, in place."""
    for i in range(len(decay)):
        for cell in range(len(elastic)):
            retarded[i, cell] = decay[i] * retarded[i, cell] + gain[i] * elastic[cell]


class CreepChain:
    """Retarded displacement fields. A step is exact if the traction is constant in it.

    All displacements are given per instantaneous compliance: ``elastic`` is J0 G q.

    Args:
        config: Spectrum of the gel.
        shape: Shape of a displacement field.
    """

    def __init__(self, config: SpectrumConfig, shape: tuple[int, ...]) -> None:
        self._fractions = np.array(config.fractions)
        self._times_s = np.array(config.times_s)
        self._retarded = np.zeros((len(self._times_s), *shape))
        self._flat = self._retarded.reshape(len(self._times_s), math.prod(shape))

    def compliance(self, dt_s: float) -> float:
        """Return the compliance over the coming step, divided by J0."""
        return 1.0 + float(self._fractions @ -np.expm1(-dt_s / self._times_s))

    def history(self, dt_s: float) -> FloatArray:
        """Return the displacement that former tractions leave at the end of the coming step, mm."""
        out = np.empty(self._retarded.shape[1:])
        creep_displacement_kernel(np.exp(-dt_s / self._times_s), self._flat, out.reshape(-1))
        return out

    def advance(self, dt_s: float, elastic: FloatArray | None) -> None:
        """Advance by one step under a constant traction.

        Args:
            dt_s: Length of the step, s.
            elastic: Instantaneous displacement under that traction, mm; None if the traction is
                zero.
        """
        decay = np.exp(-dt_s / self._times_s)
        if elastic is None:
            self._flat *= decay[:, None]
        else:
            gain = (1.0 - decay) * self._fractions
            advance_creep_kernel(decay, gain, elastic.reshape(-1), self._flat)

    def largest_mm(self) -> float:
        """Return an upper bound of the stored displacement, mm."""
        return float(sum(np.abs(part).max() for part in self._retarded))

    def reset(self) -> None:
        """Set all stored displacements to zero."""
        self._retarded[:] = 0.0
