"""One touch, the settings of its detector, and what is measured at its peak."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spikingtac.arrays import one_line
from spikingtac.calibration.pitch import marker_pitch_px
from spikingtac.errors import ConfigError
from spikingtac.touch.field import FieldGauge, FieldQuantities
from spikingtac.touch.lost_markers import spread_kernel
from spikingtac.touch.onset import NOTHING_UNSEEN, UnseenMotion
from spikingtac.touch.patch import Patch, PatchEstimator

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

# Scatter of markers of another sensor, as a share of their pitch (ours: 0.045 mm of 1.6 mm on a
# published series at rest).
SCATTER_SHARE = 0.03


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
        flat_us: Time over which a release that is over falls by less than a tenth, us (ours).
        settle_us: Time after a release within which the rest follows whatever falls, us (ours).
        start_us: Time from the first frame on that is rest, us (ours).
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
    flat_us: int = 20_000
    settle_us: int = 500_000
    start_us: int = 100_000
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


# A touch moves so many markers, against the median of all, by this share of the one that moves
# most: skin moves about its place. Less is noise in single markers (ours).
SUPPORT_MARKERS, SUPPORT_SHARE = 3, 0.15

# Least change of displacement over a pitch, root mean square, as a share of the shift that all
# markers share. Trackers err by some hundredths of a shift, which strains nothing (ours: 0.02
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
    _, most = spread_kernel(away, (markers - 0.5) / markers)
    _, least = spread_kernel(away, (markers - SUPPORT_MARKERS + 0.5) / markers)
    return least >= SUPPORT_SHARE * most


def strains(peak: TouchPeak, pitch_px: float) -> bool:
    """Return whether a peak is more than a tracker's errors in a shift that all markers share."""
    common_px = float(np.hypot(*np.median(peak.field, axis=0)))
    return peak.strength * pitch_px >= COMMON_SHARE * common_px


class PeakGauge:
    """Measures peaks on one sensor."""

    def __init__(self, reference_px: Field, scatter_px: float) -> None:
        """Prepare the patch estimator and the field's gauge.

        Args:
            reference_px: ``(m, 2)`` markers at rest, px.
            scatter_px: Standard deviation of a marker's place, per axis, px.

        Raises:
            ConfigError: Too few markers.
        """
        self._patches = PatchEstimator(reference_px)
        self._fields = FieldGauge(reference_px, scatter_px)

    def patch(self, peak: TouchPeak) -> Patch:
        """Return the touched part of the skin."""
        return self._patches.patch(peak.field)

    def touch(self, begin_us: int, end_us: int | None, peak: TouchPeak) -> Touch:
        """Return the touch of a peak from its begin to its end."""
        patch = self.patch(peak)
        return Touch(
            begin_us=begin_us,
            end_us=end_us,
            peak_us=peak.t_us,
            peak_strength=peak.strength,
            peak_displacement_px=peak.largest_px,
            place_px=patch.place,
            area_px2=patch.area,
            outline_px=patch.outline,
            field=self._fields.measure(peak.field),
        )
