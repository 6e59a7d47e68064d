"""From the detected position to the position that is given out (paper section IV-C).

``none`` gives the detected position, ``paper`` the published law, ``anchored`` a law without memory
that never drifts (:mod:`spikingtac.markers.anchored_law`). The published law is kept as written,
slips included (``docs/explanation/errata.md``): its output depends on the path.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.errors import ConfigError


class OutputLaw(Protocol):
    """Turns what was detected into what is given out."""

    def update(
        self, detected_px: NDArray[np.float64], reference_px: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the positions to give out.

        Args:
            detected_px: ``(m, 2)`` detected (or held) positions P_det, px.
            reference_px: ``(m, 2)`` calibrated rest positions P_init, px.

        Returns:
            ``(m, 2)`` positions, px; an array of its own.
        """
        ...

    def reset(self) -> None:
        """Forget the past; the next update is the first."""
        ...


class NoLaw:
    """Gives out what was detected: the truthful estimate."""

    def update(
        self, detected_px: NDArray[np.float64], reference_px: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return a copy of ``detected_px``; see :class:`OutputLaw`."""
        return detected_px.copy()

    def reset(self) -> None:
        """Do nothing: there is no past."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PaperLawConfig:
    """The published gain Γ(d) of Eq. 5.

    Attributes:
        delta_px: δ, radius of the window around the reference, px. Section IV-C: 4.0.
        gamma: γ, gain inside the window. Section IV-C: 0.7.
    """

    delta_px: float = field(default=4.0, metadata={"range": (0.0, 12.0)})
    gamma: float = field(default=0.7, metadata={"range": (0.0, 1.0)})

    def __post_init__(self) -> None:
        if not self.delta_px >= 0.0:
            raise ConfigError(f"delta_px is {self.delta_px}, it must not be negative")
        if not 0.0 <= self.gamma <= 1.0:
            raise ConfigError(f"gamma is {self.gamma}, valid is 0 to 1 (1 switches the law off)")


class PaperLaw:
    """The hysteresis-aware incremental update, exactly as published (Eqs. 2 to 5).

    P_real,t = P_real,t-1 + Γ(|P_det,t - P_init|) (P_det,t - P_det,t-1), with Γ = γ nearer than δ
    and 1 beyond. The paper does not say where the state begins; here P_real and P_det begin at
    P_init, as a calibrated sensor at rest does.

    Erratum: the state is integrated and never anchored, so that it depends on the path and on the
    rate of estimates. With the published values a loop that leaves along x and returns along y
    shifts the zero by (1 - γ) δ √2 = 1.70 px each time, and a residue of 2 px becomes 1.4 px, not
    0: the law scales residues and does not converge to P_init.

    Example:
        >>> import numpy as np
        >>> law, rest = PaperLaw(), np.zeros((1, 2))
        >>> law.update(np.array([[15.0, 0.0]]), rest).tolist()
        [[15.0, 0.0]]
        >>> law.update(rest, rest).tolist()
        [[4.5, 0.0]]
    """

    def __init__(self, config: PaperLawConfig | None = None) -> None:
        self.config = config or PaperLawConfig()
        self._detected_px: NDArray[np.float64] | None = None
        self._position_px = np.empty((0, 2))

    def update(
        self, detected_px: NDArray[np.float64], reference_px: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return P_real,t; see :class:`OutputLaw`."""
        if self._detected_px is None:
            self._detected_px = reference_px.astype(np.float64)
            self._position_px = reference_px.astype(np.float64)
        published = self.config.delta_px, self.config.gamma
        _integrate_kernel(
            detected_px, reference_px, published, self._detected_px, self._position_px
        )
        return self._position_px.copy()

    def reset(self) -> None:
        """Forget the past: the next update begins at the reference."""
        self._detected_px = None


@njit(cache=True, nogil=True)
def _integrate_kernel(
    detected_px: NDArray[np.float64],
    reference_px: NDArray[np.float64],
    published: tuple[float, float],
    before_px: NDArray[np.float64],
    position_px: NDArray[np.float64],
) -> None:  # pragma: no cover - compiled
    """Move the positions on by Eqs. 2 to 5, and keep what was detected; both in place."""
    delta_px, gamma = published
    for m in range(detected_px.shape[0]):
        x, y = detected_px[m, 0], detected_px[m, 1]
        distance = np.hypot(x - reference_px[m, 0], y - reference_px[m, 1])  # Eq. 2
        gain = 1.0 if distance >= delta_px else gamma  # Eq. 5
        position_px[m, 0] += gain * (x - before_px[m, 0])  # Eqs. 3 and 4
        position_px[m, 1] += gain * (y - before_px[m, 1])
        before_px[m, 0], before_px[m, 1] = x, y
