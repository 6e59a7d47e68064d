"""How well a calibration explains its recording: per marker, in words, and as a refusal."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import CalibrationError
from spikingtac.markers.calibration.buffered_events import BufferedEvents
from spikingtac.markers.calibration.refinement.disc_corrections import corrections
from spikingtac.markers.calibration.refinement.expected_levels import walk
from spikingtac.markers.calibration.refinement.offset_memory import OffsetMemory
from spikingtac.markers.calibration.refinement.refine import Refined
from spikingtac.markers.calibration_check import CalibrationCheck

FEWEST_EXPLAINED_SHARE = 0.5
"""A marker with few events is measured when its disc explains this share of what the median disc
explains. (Ours: the recorded marker that hardly moves has 0.33 to 0.47; simulated ones whose rest
is known to a pixel mostly have more.)"""

FEWEST_EVENTS, FEWEST_EVENTS_SHARE = 40.0, 0.25
"""Events beyond the sensor's noise that a marker needs, and the share of the median over all
markers that is enough in itself."""

DOUBTFUL_SHARE = 0.5
"""A measured marker is doubtful when its disc explains less than this share of the median."""

CHECKED_EVENTS = 1 << 16
"""Events at a time that are compared with the calibration."""

GRID_EXPLAINED = 0.15
"""Median of the explained shares below which no grid of discs was seen."""

MEMORY = OffsetMemory(30.0, 1.0)
"""Changes over some presses count, on rims as well."""

WORDS = ((0.75, "very good"), (0.55, "good"), (0.35, "usable"), (0.0, "poor"))
"""What the median of the explained shares is called."""


@dataclass(frozen=True, slots=True)
class Quality:
    """How well each marker is known.

    Attributes:
        explained: ``(m,)`` share of the pixels' level changes that the marker's disc explains.
        events: ``(m,)`` events near the marker beyond the sensor's noise.
        measured: ``(m,) bool`` whether the recording tells where the marker is.
    """

    explained: NDArray[np.float64]
    events: NDArray[np.float64]
    measured: NDArray[np.bool_]

    @property
    def median(self) -> float:
        """Median explained share of the measured markers; 0 without any."""
        return float(np.median(self.explained[self.measured])) if self.measured.any() else 0.0

    @property
    def doubtful(self) -> NDArray[np.bool_]:
        """``(m,)`` measured markers that their disc explains badly."""
        return self.measured & (self.explained < DOUBTFUL_SHARE * self.median)

    @property
    def word(self) -> str:
        """The quality in a word or two."""
        return next(word for least, word in WORDS if self.median >= least)


def level_changes(events: BufferedEvents, at: Refined) -> NDArray[np.float64]:
    """Return ``(m, 2)`` weighted squares of the level changes around each marker.

    The first is what the model leaves over, the second all changes from each pixel's mean.
    """
    # Discs that keep their shape: a stretch would explain a part of whatever is there.
    course = replace(at.course, stretch_px=None)
    seen = walk(events, course, at.states, at.discs, at.pixel, at.recovery_s)
    shown = course.shown(at.states)
    alone = replace(seen, expected=np.zeros_like(seen.expected))
    squares = [
        corrections(levels, shown, at.discs, at.pixel, MEMORY).squares for levels in (seen, alone)
    ]
    return np.column_stack(squares)


def judge(
    changes: NDArray[np.float64], events: NDArray[np.float64], noise: NDArray[np.float64]
) -> Quality:
    """Separate measured markers from those that the recording does not show.

    Args:
        changes: ``(m, 2)`` weighted squares of the level changes around each marker: those that
            the discs leave over, and all.
        events: ``(m, 4)`` real ON and OFF events near each marker, expected ON and OFF.
        noise: ``(2,)`` ON and OFF events that come without motion.
    """
    explained = 1.0 - changes[:, 0] / np.maximum(changes[:, 1], 1e-9)
    above = (events[:, :2] - noise).sum(axis=1)
    busy = above >= FEWEST_EVENTS_SHARE * np.median(above)
    clear = explained >= FEWEST_EXPLAINED_SHARE * np.median(explained)
    measured = (above >= FEWEST_EVENTS) & (busy | clear)
    return Quality(explained.clip(-1.0, 1.0), above, measured)


def refuse_without_grid(quality: Quality) -> None:
    """Refuse what is no grid of discs.

    Raises:
        CalibrationError: Discs on a grid do not explain the events.
    """
    median = float(np.median(quality.explained))
    if median < GRID_EXPLAINED:
        raise CalibrationError(
            f"no grid of markers: discs in rows and columns explain {max(median, 0.0):.0%} of "
            f"what the pixels saw, where a marker sensor gives {GRID_EXPLAINED:.0%} and more. If "
            "this is one, its markers hardly moved: press or slide until they move by more than "
            "their diameter; otherwise the recording shows something else"
        )


def own_contradiction(events: BufferedEvents, calibration: Calibration) -> float:
    """Return by how much a recording contradicts the calibration that was learned from it.

    Args:
        events: The recording, markers brighter than the ground.
        calibration: What was learned.
    """
    check = CalibrationCheck(replace(calibration, polarity="white"))
    check.limit = 1.0  # to the end, whatever is found
    begin = 0
    while begin < len(events) and not check.ended:
        end = min(begin + CHECKED_EVENTS, len(events))
        first_us, last_us = (int(events.time_us[i]) for i in (begin, end - 1))
        check.absorb(events.packet((begin, end), (first_us, last_us + 1)))
        begin = end
    check.finish()
    return check.contradiction


def provenance(quality: Quality) -> dict[str, Any]:
    """Return the quality as keys of a calibration's provenance."""
    return {
        "quality": quality.word,
        "doubtful": np.flatnonzero(quality.doubtful).tolist(),
        "explained": np.round(quality.explained, 3).tolist(),
        "events": np.round(quality.events).astype(int).tolist(),
    }
