"""Why a measured X_real is not the true one: resetting by hand, and micro-slip of the probe.

The paper finds X_real by teleoperation "until the onset of physical contact" and explains its
negative deviations, "within 0.5 mm", by reset errors and by micro-slip of the probe between the
fingers (Section V-B).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ResetErrorConfig:
    """How far a teleoperated X_real may lie from the true one.

    Attributes:
        reset_sigma_mm: Of the position at which a person calls it contact, mm (ours: half of the
            spread, so that three standard deviations of both together reach the paper's 0.5 mm).
        slip_sigma_mm: Of the probe's slip between reset and trial, mm (ours: the other half).
    """

    reset_sigma_mm: float = 0.12
    slip_sigma_mm: float = 0.12

    def __post_init__(self) -> None:
        if min(self.reset_sigma_mm, self.slip_sigma_mm) < 0.0:
            raise ValueError("reset_sigma_mm and slip_sigma_mm must not be negative")


def teleoperated_mm(
    real_mm: Vector, direction: Vector, config: ResetErrorConfig, rng: np.random.Generator
) -> Vector:
    """Return X_real ``(3,)`` as a person would have measured it, mm.

    Args:
        real_mm: ``(3,)`` the true X_real, mm.
        direction: ``(3,)`` unit vector of the approach; the error lies along it.
        config: How large the error is.
        rng: Source of the error.
    """
    error_mm = rng.normal(0.0, np.hypot(config.reset_sigma_mm, config.slip_sigma_mm))
    return real_mm + float(error_mm) * direction
