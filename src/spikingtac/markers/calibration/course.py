"""Where the markers went, sample by sample, and what the events of each pixel stand for."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

LEADERS = 4
"""Nearest markers whose mean motion stands for that of a marker that could not be followed."""


@dataclass(frozen=True, slots=True)
class PixelSteps:
    """What one event of each pixel stands for, shares of a full swing.

    Attributes:
        on: ``(height, width)`` float32 share of an ON event.
        off: The same for OFF events.
    """

    on: NDArray[np.float32]
    off: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Course:
    """Where the markers went.

    Attributes:
        index: ``(n,)`` how many events came before each sample.
        center_px: ``(n, m, 2)`` places, px.
        agreement: ``(n, m)`` share of each marker's edge that agreed with the fit.
        stretch_px: ``(n, m, 3)`` growth of each radius, and its second harmonic, px; None where
            discs keep their shape.
    """

    index: NDArray[np.int64]
    center_px: NDArray[np.float64]
    agreement: NDArray[np.float64]
    stretch_px: NDArray[np.float64] | None = None

    @property
    def stretches(self) -> NDArray[np.float64]:
        """``(n, m, 3)`` stretches, zeros where discs keep their shape, px."""
        if self.stretch_px is None:
            return np.zeros((*self.center_px.shape[:2], 3))
        return self.stretch_px

    def shown(self, samples: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the places ``(k, m, 2)`` and the stretches ``(k, m, 3)`` at some samples, px."""
        return self.center_px[samples], self.stretches[samples]


def led_by_neighbours(course: Course, sample: int, stuck: NDArray[np.bool_]) -> Course:
    """Return a course on which stuck markers go where the nearest others go on the average.

    Args:
        course: Where the markers went.
        sample: Where they rest, the stuck ones too.
        stuck: ``(m,)`` which markers were not followed.
    """
    rest_px, free = course.center_px[sample], np.flatnonzero(~stuck)
    center_px = course.center_px.copy()
    for marker in np.flatnonzero(stuck):
        apart_px = np.hypot(*(rest_px[free] - rest_px[marker]).T)
        leaders = free[np.argsort(apart_px, kind="stable")[:LEADERS]]
        moved_px = (course.center_px[:, leaders] - rest_px[leaders]).mean(axis=1)
        center_px[:, marker] = rest_px[marker] + moved_px
    return replace(course, center_px=center_px)
