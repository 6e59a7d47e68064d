"""One touch, the settings of its detector, and what is measured at its peak."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.arrays import one_line
from spikingtac.calibration.pitch import marker_pitch_px
from spikingtac.errors import ConfigError
from spikingtac.touch.field import FieldQuantities
from spikingtac.touch.lost_markers import spread_of

Field = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Touch:
    """A touch from its first motion to its release.

    Lengths are in the unit of the detector's markers: px, or mm where it was set to that.

    Attributes:
        begin_us: When the skin began to move, us.
        end_us: When the skin was released, us; None where the recording ended first.
        peak_us: When the skin was deformed most, us.
        peak_strength: Strength of the displacement's gradient then (1 is 100 % strain).
        peak_displacement_px: Largest displacement of a marker over the touch, px.
        place_px: ``(2,)`` centre of the contact patch at the peak, px.
        area_px2: Area of that patch, px squared.
        outline_px: ``(k, 2)`` its convex outline, px.
        field: Shear, torsion, divergence, curl and strain of the whole field at the peak, with the
            deviations of markers that scatter by ``TouchConfig.least_displacement_px``.
    """

    begin_us: int
    end_us: int | None
    peak_us: int
    peak_strength: float
    peak_displacement_px: float
    place_px: NDArray[np.float64]
    area_px2: float
    outline_px: NDArray[np.float64]
    field: FieldQuantities

    __repr__ = one_line

    @property
    def duration_us(self) -> int | None:
        """Time from begin to end, us; None where the end was not seen."""
        return None if self.end_us is None else self.end_us - self.begin_us


UNITS = ("px", "mm")

# Scatter of markers of another sensor, as a share of their pitch (0.045 mm of 1.6 mm on a
# published series at rest).
SCATTER_SHARE = 0.03


@dataclass(frozen=True, kw_only=True)
class TouchConfig:
    """Which sensor's markers are watched; as they stand, those of an event camera, in px.

    Attributes:
        least_displacement_px: Scatter of a marker that is no touch, px; the threshold is the
            gradient's strength of markers that scatter so (0.2 px is twenty times the scatter of
            the tracker ``default`` on the twin at rest; its steps are smaller).
        sees_changes: Whether the camera sees changes only, and not the beginning of a motion that
            follows another.
    """

    least_displacement_px: float = 0.2
    sees_changes: bool = True

    def __post_init__(self) -> None:
        if not self.least_displacement_px > 0:
            raise ValueError(
                f"least_displacement_px is {self.least_displacement_px}, it must be positive"
            )

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
        return cls(least_displacement_px=least, sees_changes=False)


# A touch moves so many markers, against the median of all, by this share of the one that moves
# most: skin moves about its place. Less is noise in single markers.
SUPPORT_MARKERS, SUPPORT_SHARE = 3, 0.15

# Least change of displacement over a pitch, root mean square, as a share of the shift that all
# markers share. Trackers err by some hundredths of a shift, which strains nothing (0.02
# under a plate that shifts the skin by 15 px; touches reach 0.8 and more).
COMMON_SHARE = 0.1


@dataclass(slots=True)
class TouchPeak:
    """The most of an open touch so far.

    Attributes:
        field: ``(m, 2)`` displacements where the skin is deformed most, px.
        strength: Strength of their gradient.
        t_us: When that was, us.
        largest_px: Largest displacement of a marker, whenever it was, px.
        spread: Largest displacement that most of the markers reach, whenever it was, px.
        spreads: Whether at the peak more markers moved than a fault of one or two explains.
    """

    field: Field
    strength: float = 0.0
    t_us: int = 0
    largest_px: float = 0.0
    spread: float = 0.0
    spreads: bool = True


def spreads(away: Field) -> bool:
    """Return whether displacements ``(m, 2)`` are more than a fault of one or two markers."""
    markers = len(away)
    if markers <= 2 * SUPPORT_MARKERS:
        return True
    _, most = spread_of(away, (markers - 0.5) / markers)
    _, least = spread_of(away, (markers - SUPPORT_MARKERS + 0.5) / markers)
    return least >= SUPPORT_SHARE * most


def strains(peak: TouchPeak, pitch_px: float) -> bool:
    """Return whether a peak is more than a tracker's errors in a shift that all markers share."""
    common_px = float(np.hypot(*np.median(peak.field, axis=0)))
    return peak.strength * pitch_px >= COMMON_SHARE * common_px
