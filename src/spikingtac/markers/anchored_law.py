"""An output that is quiet at zero and cannot drift: a radial map without memory.

If the output's increment is to vanish on every closed path, and not to depend on how often one
looks, the law has no memory; if no direction is preferred, it is radial:
P = P_init + f(|a|) a / |a| with a = P_det - P_init. Nothing else exists. Near zero f has slope γ,
from δ2 on it is the identity, so that in between it must be steeper than 1, at the least
(δ2 - γ δ1) / (δ2 - δ1), and some small true displacements come out falsified. Therefore the
truthful estimate (law ``none``) is the default, this one a choice of those who want a quiet zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError


@dataclass(frozen=True, kw_only=True, slots=True)
class AnchoredLawConfig:
    """The radial map f; the default trades a worst falsification below 0.6 px for a slope of 1.83.

    Attributes:
        gamma: γ, slope of the map near zero (1 is the identity).
        delta1_px: δ1, distance up to which the slope is γ, px.
        delta2_px: δ2, distance from which the map is the identity, px.
    """

    gamma: float = field(default=0.3, metadata={"range": (0.05, 1.0)})
    delta1_px: float = 0.75
    delta2_px: float = 2.0

    def __post_init__(self) -> None:
        if not 0.0 < self.gamma <= 1.0:
            raise ConfigError(f"gamma is {self.gamma}, valid is 0 < gamma <= 1")
        if not 0.0 <= self.delta1_px < self.delta2_px:
            raise ConfigError(
                f"delta1_px {self.delta1_px} and delta2_px {self.delta2_px} must be ordered, "
                "0 <= delta1_px < delta2_px"
            )

    @property
    def chord_slope(self) -> float:
        """Mean slope between δ1 and δ2: what no continuous law of this kind can stay below."""
        rise_px = self.delta2_px - self.gamma * self.delta1_px
        return rise_px / (self.delta2_px - self.delta1_px)

    @property
    def steepest_slope(self) -> float:
        """Largest slope of f: how much jitter is amplified at worst."""
        bend = self._bend
        if bend >= 0.0:  # only where gamma is 1: the identity
            return 1.0
        # f' = bend s^2 + (chord part) s + γ on s in [0, 1]; its vertex lies inside.
        linear = 1.0 - self.gamma - bend
        return self.gamma - linear**2 / (4.0 * bend)

    @property
    def worst_falsification_px(self) -> float:
        """Largest |f(d) - d|, px: how far a true displacement can come out wrong."""
        bend = self._bend
        if bend >= 0.0:
            return 0.0
        # f' = 1 at s = 1 and where the product of the roots of f' - 1 puts the other one.
        share = (self.gamma - 1.0) / bend
        distance_px = self.delta1_px + share * (self.delta2_px - self.delta1_px)
        return abs(distance_px - float(self.radius_px(np.array(distance_px))))

    @property
    def _bend(self) -> float:
        return 3.0 * (self.gamma + 1.0 - 2.0 * self.chord_slope)

    def radius_px(self, distance_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return f of distances, px: γ d, then a cubic with continuous slope, then d."""
        span_px = self.delta2_px - self.delta1_px
        share = np.clip((distance_px - self.delta1_px) / span_px, 0.0, 1.0)
        # Integral of f' = γ + (1 - γ - bend) s + bend s^2 from δ1 on.
        bend = self._bend
        cubic = self.gamma * share + (1.0 - self.gamma - bend) * share**2 / 2.0
        between = self.gamma * self.delta1_px + span_px * (cubic + bend * share**3 / 3.0)
        near = np.where(distance_px <= self.delta1_px, self.gamma * distance_px, between)
        return np.where(distance_px >= self.delta2_px, distance_px, near)


class AnchoredLaw:
    """Gives out P_init + f(|a|) a / |a|: depends on the present detection alone.

    Example:
        >>> import numpy as np
        >>> law, rest = AnchoredLaw(), np.zeros((2, 2))
        >>> law.update(np.array([[0.5, 0.0], [0.0, 8.0]]), rest).round(3).tolist()
        [[0.15, 0.0], [0.0, 8.0]]
    """

    def __init__(self, config: AnchoredLawConfig | None = None) -> None:
        self.config = config or AnchoredLawConfig()

    def update(
        self, detected_px: NDArray[np.float64], reference_px: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the zeroed positions; see :class:`~spikingtac.markers.hysteresis.OutputLaw`."""
        return reference_px + _radially_mapped(detected_px - reference_px, self.config)

    def reset(self) -> None:
        """Do nothing: there is no past."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ReZeroConfig:
    """How fast and how far the zero may follow what is left after a contact.

    Attributes:
        map: The radial map around the zero.
        time_constant_us: τ, us: 2 s, so that a contact shorter than that leaves little trace even
            where nobody tells of it.
        reach_px: ρ, largest distance of the zero from the reference, px: 1.5 covers the residue of
            fifty contacts in a row (up to 0.61 px in simulation) twice over.
    """

    map: AnchoredLawConfig = field(default_factory=AnchoredLawConfig)
    time_constant_us: int = 2_000_000
    reach_px: float = 1.5

    def __post_init__(self) -> None:
        if self.time_constant_us < 1:
            raise ConfigError(f"time_constant_us is {self.time_constant_us}, it must be positive")
        if not self.reach_px >= 0.0:
            raise ConfigError(f"reach_px is {self.reach_px}, it must not be negative")


class ReZero:
    """The anchored law around a zero that learns the residue while nothing touches the skin.

    z <- z + (1 - exp(-dt / τ)) (sat_ρ(a) - z), and the output is P_init + f(|a - z|) along a - z.

    The zero is frozen unless :meth:`observe` says that nothing is in contact: absence of contact
    cannot be read from silence, since a static press is silent as well. What no such law can do: a
    static contact that keeps every marker within ρ looks exactly like residue, and if it is told
    to be no contact it fades to zero within a few τ. This law has memory, through z alone, and
    never further than ρ.
    """

    def __init__(self, config: ReZeroConfig | None = None) -> None:
        self.config = config or ReZeroConfig()
        self._zero_px: NDArray[np.float64] | None = None
        self._elapsed_us = 0
        self._observed_us: int | None = None

    @property
    def zero_px(self) -> NDArray[np.float64] | None:
        """``(m, 2)`` the zero z relative to the reference, px; None before the first update."""
        return self._zero_px

    def observe(self, t_us: int, in_contact: bool) -> None:
        """Tell the time of the coming update, and whether the skin was touched since the last.

        Args:
            t_us: Time, us; never decreasing.
            in_contact: True freezes the zero over this stretch.
        """
        if self._observed_us is not None and not in_contact:
            self._elapsed_us += max(0, t_us - self._observed_us)
        self._observed_us = t_us

    def update(
        self, detected_px: NDArray[np.float64], reference_px: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the positions around the zero; see :class:`AnchoredLaw`."""
        displacement = detected_px - reference_px
        if self._zero_px is None:
            self._zero_px = np.zeros_like(displacement)
        if self._elapsed_us:
            share = -math.expm1(-self._elapsed_us / self.config.time_constant_us)
            target = _saturated(displacement, self.config.reach_px)
            self._zero_px = self._zero_px + share * (target - self._zero_px)
            self._elapsed_us = 0
        return reference_px + _radially_mapped(displacement - self._zero_px, self.config.map)

    def reset(self) -> None:
        """Put the zero back on the reference and forget the time."""
        self._zero_px, self._elapsed_us, self._observed_us = None, 0, None


def _radially_mapped(
    displacement_px: NDArray[np.float64], config: AnchoredLawConfig
) -> NDArray[np.float64]:
    distance = np.hypot(displacement_px[:, 0], displacement_px[:, 1])
    # The quotient is γ in the limit of no displacement, and 0 / 0 is never formed.
    safe = np.where(distance > 0.0, distance, 1.0)
    gain = np.where(distance > 0.0, config.radius_px(distance) / safe, config.gamma)
    return gain[:, np.newaxis] * displacement_px


def _saturated(vectors_px: NDArray[np.float64], reach_px: float) -> NDArray[np.float64]:
    distance = np.hypot(vectors_px[:, 0], vectors_px[:, 1])
    gain = reach_px / np.maximum(distance, max(reach_px, np.finfo(np.float64).tiny))
    return gain[:, np.newaxis] * vectors_px
