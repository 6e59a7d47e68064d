"""From the detected position to the position that is given out (paper section IV-C).

``none`` gives the detected position, ``paper`` the published law, ``anchored`` a law without memory
that never drifts. The published law is kept as written, slips included
(``docs/explanation/errata.md``): its output depends on the path.

The anchored law: if the output's increment is to vanish on every closed path, and not to depend on
how often one looks, the law has no memory; if no direction is preferred, it is radial:
P = P_init + f(|a|) a / |a| with a = P_det - P_init. Near zero f has slope γ, from δ2 on it is the
identity, so that in between it is steeper than 1, and some small true displacements come out
falsified: by 0.59 px at worst. Therefore the truthful estimate is the default.
"""

from dataclasses import dataclass, field

import numpy as np

from spikingtac.schema import require_within
from spikingtac.types import FloatArray

# Slope of the anchored law near zero; distances up to which it holds and from which the law is the
# identity, px (a steepest slope of 1.83, a falsification below 0.6 px).
ANCHORED_GAMMA, DELTA1_PX, DELTA2_PX = 0.3, 0.75, 2.0


class OutputLaw:
    """Gives out what was detected: the truthful estimate, and the base of the other laws."""

    def update(self, detected_px: FloatArray, reference_px: FloatArray) -> FloatArray:
        """Return the positions to give out.

        Args:
            detected_px: ``(m, 2)`` detected (or held) positions P_det, px.
            reference_px: ``(m, 2)`` calibrated rest positions P_init, px.

        Returns:
            ``(m, 2)`` positions, px; an array of its own.
        """
        return detected_px.copy()

    def reset(self) -> None:
        """Forget the past; the next update is the first."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PaperLawConfig:
    """The published gain Γ(d) of Eq. 5.

    Attributes:
        delta_px: δ, radius of the window around the reference, px. Section IV-C: 4.0.
        gamma: γ, gain inside the window; 1 switches the law off. Section IV-C: 0.7.
    """

    delta_px: float = field(default=4.0, metadata={"range": (0.0, 12.0)})
    gamma: float = field(default=0.7, metadata={"range": (0.0, 1.0)})

    def __post_init__(self) -> None:
        require_within(self, delta_px=(0.0, 1e3), gamma=(0.0, 1.0))


class PaperLaw(OutputLaw):
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
        self._before_px: FloatArray | None = None
        self._position_px = np.empty((0, 2))

    def update(self, detected_px: FloatArray, reference_px: FloatArray) -> FloatArray:
        """Return P_real,t; see :class:`OutputLaw`."""
        if self._before_px is None:
            self._before_px = self._position_px = reference_px.astype(np.float64)
        distance_px = np.hypot(*(detected_px - reference_px).T)  # Eq. 2
        gain = np.where(distance_px >= self.config.delta_px, 1.0, self.config.gamma)  # Eq. 5
        step_px = gain[:, np.newaxis] * (detected_px - self._before_px)  # Eq. 3
        self._position_px = self._position_px + step_px  # Eq. 4
        self._before_px = detected_px.copy()
        return self._position_px.copy()

    def reset(self) -> None:
        """Forget the past: the next update begins at the reference."""
        self._before_px = None


class AnchoredLaw(OutputLaw):
    """Gives out P_init + f(|a|) a / |a|: depends on the present detection alone.

    Example:
        >>> import numpy as np
        >>> law, rest = AnchoredLaw(), np.zeros((2, 2))
        >>> law.update(np.array([[0.5, 0.0], [0.0, 8.0]]), rest).round(3).tolist()
        [[0.15, 0.0], [0.0, 8.0]]
    """

    def update(self, detected_px: FloatArray, reference_px: FloatArray) -> FloatArray:
        """Return the zeroed positions; see :class:`OutputLaw`."""
        away_px = detected_px - reference_px
        # Never 0 / 0: in the limit of no displacement the quotient is γ.
        distance_px = np.hypot(away_px[:, 0], away_px[:, 1]).clip(1e-9)
        return reference_px + (anchored_px(distance_px) / distance_px)[:, np.newaxis] * away_px


def anchored_px(distance_px: FloatArray) -> FloatArray:
    """Return f of distances, px: γ d, then a cubic with continuous slope, then d."""
    gamma, span_px = ANCHORED_GAMMA, DELTA2_PX - DELTA1_PX
    s = np.clip((distance_px - DELTA1_PX) / span_px, 0.0, 1.0)
    # Integral of f' = γ + (1 - γ - bend) s + bend s^2 over s, times the span: f(δ2) is δ2.
    bend = 3.0 * (gamma + 1.0 - 2.0 * (DELTA2_PX - gamma * DELTA1_PX) / span_px)
    between_px = span_px * (gamma * s + (1.0 - gamma - bend) * s**2 / 2.0 + bend * s**3 / 3.0)
    near_px = gamma * np.minimum(distance_px, DELTA1_PX)
    return near_px + between_px + np.maximum(distance_px - DELTA2_PX, 0.0)
