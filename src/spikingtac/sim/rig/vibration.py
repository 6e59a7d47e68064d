"""Vibration of the arm: a resonance driven by noise, with an exact step of any length."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm


@dataclass(frozen=True, kw_only=True)
class VibrationConfig:
    """Vibration at the tool (contract.md, "Pinned physics").

    Attributes:
        rms_mm: Root mean square per axis, mm: 0 (``clean``), 0.01 (``typical``), 0.03 (``noisy``).
        frequency_hz: Resonance of the arm, Hz.
        quality: Q of the resonance.
    """

    rms_mm: float = 0.01
    frequency_hz: float = 15.0
    quality: float = 5.0


class Vibration:
    """Three independent axes of x'' + (w/Q) x' + w^2 x = white noise, in their stationary state.

    The transition over a step is exact, so that the statistics do not depend on its length.

    Args:
        config: Amplitude and resonance.
        rng: Source of the noise.
    """

    def __init__(self, config: VibrationConfig, rng: np.random.Generator) -> None:
        self._config = config
        self._rng = rng
        self._state = np.linalg.cholesky(_stationary(config)) @ rng.standard_normal((2, 3))

    @property
    def offset_mm(self) -> NDArray[np.float64]:
        """Displacement ``(3,)`` of the tool now, mm."""
        return self._config.rms_mm * self._state[0]

    def advance(self, dt_s: float) -> NDArray[np.float64]:
        """Step by ``dt_s`` and return the new displacement ``(3,)``, mm."""
        if self._config.rms_mm > 0.0:
            move, noise = transition(self._config, round(dt_s * 1e9))
            self._state = move @ self._state + noise @ self._rng.standard_normal((2, 3))
        return self.offset_mm


def _system(config: VibrationConfig) -> NDArray[np.float64]:
    omega = 2.0 * np.pi * config.frequency_hz
    return np.array([[0.0, 1.0], [-(omega**2), -omega / config.quality]])


def _stationary(config: VibrationConfig) -> NDArray[np.float64]:
    """Return the covariance of (x, x') for unit variance of x."""
    return np.diag([1.0, (2.0 * np.pi * config.frequency_hz) ** 2])


@functools.lru_cache(maxsize=64)
def transition(
    config: VibrationConfig, dt_ns: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the exact transition of a step ``(2, 2)`` and a root of its noise's covariance."""
    system, stationary = _system(config), _stationary(config)
    transition = np.asarray(expm(system * dt_ns * 1e-9), np.float64)
    drive = stationary - transition @ stationary @ transition.T
    return transition, np.linalg.cholesky(drive).astype(np.float64)
