"""When touches begin and end: the settings of their detector."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.pitch import marker_pitch_px
from spikingtac.errors import ConfigError
from spikingtac.touch.touches.backlash import NOTHING_UNSEEN, UnseenMotion

UNITS = ("px", "mm")
SCATTER_SHARE = 0.03
"""Scatter of markers of another sensor, as a share of their pitch (ours: 0.045 mm of 1.6 mm on a
published series at rest)."""


@dataclass(frozen=True, kw_only=True)
class TouchConfig:
    """When a touch begins and ends.

    The lengths among them are px, and as they stand those of an event camera's markers; for markers
    in mm take :meth:`for_unit`.

    Attributes:
        least_displacement_px: Scatter of a marker that is no touch, px; the threshold is the
            gradient's strength of markers that scatter so (ours: 0.2 px, twenty times the scatter
            of the tracker ``default`` on the twin at rest; its steps are smaller).
        noise_factor: Times the strength at rest that a touch must exceed (ours).
        end_share: Share of the peak strength below which the skin is released (ours: residues lie
            below 0.18 and touches above 0.28 on the ten scenes).
        still_share: Share of the peak strength below which the skin is released where it also
            stands still: a tracker of a sensor with rare OFF events keeps some of it (ours: 0.26
            on a recorded gel; holds of the ten scenes lie above 0.3).
        still_us: Time for which it must stand still for that, us (ours).
        end_hold_us: Time below that share that is needed, us (ours: a shake of 12 Hz passes
            through its rest for 5 ms).
        flat_us: Time over which a release that is over falls by less than a tenth, us (ours).
        release_us: Longest time that a release may take from there on, us (ours).
        settle_us: Time after a release within which the rest follows whatever falls, us (ours).
        resting_us: Time constant of the rest otherwise, us (ours: slower presses are lost).
        start_us: Time from the first frame on that is rest, us (ours).
        start_strength: Strength against the calibrated rest up to which that holds (ours: a real
            gel, which creeps, rested at 0.009 to 0.031 from where it was calibrated; its presses
            reach 0.09 and more).
        unseen: What the camera does not see of the beginning of a motion.
    """

    least_displacement_px: float = field(
        default=0.2,
        metadata={"range": (0.02, 5.0), "about": "scatter of a marker that is no touch"},
    )
    noise_factor: float = field(
        default=6.0,
        metadata={"range": (1.0, 50.0), "about": "times the strength at rest that a touch exceeds"},
    )
    end_share: float = field(
        default=0.22,
        metadata={"range": (0.05, 0.9), "about": "share of the peak at which the skin is released"},
    )
    still_share: float = 0.3
    still_us: int = 400_000
    end_hold_us: int = 40_000
    flat_us: int = 20_000
    release_us: int = 150_000
    settle_us: int = 500_000
    resting_us: int = 2_000_000
    start_us: int = 100_000
    start_strength: float = 0.05
    unseen: UnseenMotion = field(default_factory=UnseenMotion)

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            if name != "unseen" and not getattr(self, name) > 0:
                raise ValueError(f"{name} is {getattr(self, name)}, it must be positive")
        if not self.end_share < 1:
            raise ValueError(f"end_share is {self.end_share}, it must be below 1")

    @classmethod
    def for_unit(cls, reference: NDArray[np.float64], unit: str) -> TouchConfig:
        """Return the settings for markers whose places are in a unit.

        Those in px are taken to be seen by an event camera, those in mm by a sensor that sees
        places and not changes. With the settings for mm every length is in mm, that of
        ``least_displacement_px`` and those of the touches, too.

        Args:
            reference: ``(m, 2)`` markers at rest, in that unit.
            unit: ``px`` or ``mm``.

        Raises:
            ConfigError: Fewer than two markers, or another unit.
        """
        if unit not in UNITS:
            raise ConfigError(f"the unit of the markers is {unit!r}, valid: {', '.join(UNITS)}")
        if unit == "px":
            return cls()
        least = SCATTER_SHARE * marker_pitch_px(reference)
        return cls(least_displacement_px=least, unseen=NOTHING_UNSEEN)
