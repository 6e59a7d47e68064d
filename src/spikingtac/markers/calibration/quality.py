"""How well a calibration explains its recording: per marker, in words, and as a refusal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError

FEWEST_EXPLAINED = 0.35
"""Share of the level changes around a marker that its disc must explain for its place to count as
measured. (Ours: discs that are there explain 0.6 and more, discs put elsewhere less than 0.2.)"""

FEWEST_EVENTS = 40.0
"""Events beyond the sensor's noise that a marker needs, of both polarities together."""

GRID_EXPLAINED = 0.45
"""Median of that share over all markers below which no grid of discs was seen."""

WORDS = ((0.85, "very good"), (0.7, "good"), (0.55, "usable"), (0.0, "poor"))
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
    def word(self) -> str:
        """The quality in a word or two."""
        return next(word for least, word in WORDS if self.median >= least)


def judge(
    changes: NDArray[np.float64], events: NDArray[np.float64], noise: NDArray[np.float64]
) -> Quality:
    """Tell measured markers from those that the recording does not show.

    Args:
        changes: ``(m, 2)`` weighted squares of the level changes around each marker: those that
            the discs leave over, and all.
        events: ``(m, 4)`` real ON and OFF events near each marker, expected ON and OFF.
        noise: ``(2,)`` ON and OFF events that come without motion.
    """
    explained = 1.0 - changes[:, 0] / np.maximum(changes[:, 1], 1e-9)
    above = (events[:, :2] - noise).sum(axis=1)
    measured = (explained >= FEWEST_EXPLAINED) & (above >= FEWEST_EVENTS)
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
            f"what the pixels saw, where a marker sensor gives {GRID_EXPLAINED:.0%} and more; the "
            "recording seems to show something else"
        )


def provenance(quality: Quality) -> dict[str, Any]:
    """Return the quality as keys of a calibration's provenance."""
    return {
        "quality": quality.word,
        "explained": np.round(quality.explained, 3).tolist(),
        "events": np.round(quality.events).astype(int).tolist(),
    }
