"""Follow the markers through a recording, forwards and backwards.

Each pixel keeps the level at which it last fired. The true level lies within a band around it,
from one OFF step below to one ON step above, and most likely half a step beyond in the direction
of the last event. A disc is fitted to these levels at each sample by Gauss-Newton; then the levels
are drawn towards the bands that the discs allow, so that noise and wrong steps do not add up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.calibration.buffered_events import BufferedEvents
from spikingtac.markers.calibration.disc_fits import fit_kernel
from spikingtac.markers.calibration.disc_levels import (
    Discs,
    draw_kernel,
    nearest_markers,
)

PULL = 0.2
"""Share of a band's violation that is taken away at each sample."""

FEWEST_AGREEMENT = 0.45
"""A disc is believed when so much of its edge agrees."""

SPEED_KEPT = 0.8
"""Share of the last step by which a marker is expected to go on."""

LED_SHARE = 0.3
"""Share by which a disc that is not believed is drawn to where its neighbours went."""


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


class Follower:
    """Follows markers of a recording, as often as needed.

    Args:
        events: The recording, markers brighter than the ground.
        index: ``(n,)`` how many events came before each sample, increasing.
    """

    def __init__(self, events: BufferedEvents, index: NDArray[np.int64]) -> None:
        self._events, self._index = events, index
        self._before = np.empty(len(events), np.int8)
        self._last = np.zeros(events.pixels, np.int8)
        note_polarity_kernel(events.code, self._last, self._before)

    def both_ways(
        self,
        seen: tuple[int, NDArray[np.float32], NDArray[np.float64]],
        discs: Discs,
        steps: PixelSteps,
    ) -> Course:
        """Go on to the end from one sample, all the way back, and forth; average the last two.

        Args:
            seen: A sample, the level map ``(height, width)`` and the places ``(m, 2)`` at it.
            discs: How the markers look.
            steps: What events stand for.
        """
        sample, level, center_px = seen
        level = level.ravel().copy()
        nothing = np.zeros(self._events.pixels, np.int8)
        onward = np.arange(sample, len(self._index))
        on = self._walk((level, nothing), onward, center_px, discs, steps)
        backward = np.arange(len(self._index))[::-1].copy()
        back = self._walk((level, self._last.copy()), backward, on.center_px[-1], discs, steps)
        forward = backward[::-1].copy()
        nothing = np.zeros(self._events.pixels, np.int8)
        forth = self._walk((level, nothing), forward, back.center_px[0], discs, steps)
        return Course(
            self._index,
            0.5 * (back.center_px + forth.center_px),
            np.minimum(back.agreement, forth.agreement),
        )

    def _walk(
        self,
        state: tuple[NDArray[np.float32], NDArray[np.int8]],
        order: NDArray[np.int64],
        start_px: NDArray[np.float64],
        discs: Discs,
        steps: PixelSteps,
    ) -> Course:
        markers = len(discs.radius_px)
        center_px = np.zeros((len(self._index), markers, 2))
        agreement = np.zeros((len(self._index), markers))
        follow_kernel(
            (state[0].reshape(self._events.shape), state[1].reshape(self._events.shape)),
            (self._events.code, self._before),
            (self._index, order),
            (steps.on, steps.off),
            (discs.shape, discs.tables, discs.fit_tables, nearest_markers(start_px)),
            (start_px, center_px, agreement),
        )
        return Course(self._index, center_px, agreement)


@njit(cache=True)
def note_polarity_kernel(
    code: NDArray[np.uint32], last: NDArray[np.int8], before: NDArray[np.int8]
) -> None:
    """Note for each event the polarity of the one before it in its pixel, 0 for the first."""
    for i in range(len(code)):
        pixel = code[i] >> 1
        before[i] = last[pixel]
        last[pixel] = 1 if code[i] & 1 else -1


@njit(cache=True)
def move_kernel(
    state: tuple[NDArray[np.float32], NDArray[np.int8]],
    events: tuple[NDArray[np.uint32], NDArray[np.int8]],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
    first: Any,
    last: Any,
) -> None:
    """Bring levels and last polarities from ``first`` events to ``last``, either way in time."""
    level, side = state
    code, before = events
    on, off = steps
    for i in range(first, last):
        pixel = code[i] >> 1
        level[pixel] += on[pixel] if code[i] & 1 else -off[pixel]
        side[pixel] = 1 if code[i] & 1 else -1
    for back in range(first - last):
        i = first - 1 - back
        pixel = code[i] >> 1
        level[pixel] -= on[pixel] if code[i] & 1 else -off[pixel]
        side[pixel] = before[i]


@njit(cache=True)
def lead_kernel(
    center: NDArray[np.float64],
    start: NDArray[np.float64],
    agreement: NDArray[np.float64],
    nearest: NDArray[np.int64],
) -> None:
    """Draw discs that are not believed towards where their believed neighbours went."""
    for m in range(len(center)):
        if agreement[m] >= FEWEST_AGREEMENT:
            continue
        count, dx, dy = 0, 0.0, 0.0
        for other in nearest[m]:
            if agreement[other] > FEWEST_AGREEMENT:
                dx += center[other, 0] - start[other, 0]
                dy += center[other, 1] - start[other, 1]
                count += 1
        if count >= 2:
            center[m, 0] += LED_SHARE * (start[m, 0] + dx / count - center[m, 0])
            center[m, 1] += LED_SHARE * (start[m, 1] + dy / count - center[m, 1])


@njit(cache=True)
def pull_kernel(
    level: NDArray[np.float32],
    expected: NDArray[np.float32],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
) -> None:
    """Draw each level towards the band within which the expected one would keep it."""
    on, off = steps
    for i in range(len(level)):
        apart = expected[i] - level[i]
        level[i] += np.float32(PULL) * (
            max(apart - on[i], np.float32(0.0)) + min(apart + off[i], np.float32(0.0))
        )


@njit(cache=True)
def follow_kernel(
    state: tuple[NDArray[np.float32], NDArray[np.int8]],
    events: tuple[NDArray[np.uint32], NDArray[np.int8]],
    samples: tuple[NDArray[np.int64], NDArray[np.int64]],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
    discs: tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]],
    out: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
) -> None:
    """Visit the samples in the given order and fit all discs at each.

    Args:
        state: ``(height, width)`` levels and last polarities at the first sample visited; changed.
        events: Codes, and the polarity before each.
        samples: Events before each sample, and the order of the visit.
        steps: ``(height, width)`` ON and OFF shares.
        discs: Shapes, both kinds of tables and nearest others.
        out: Places at the first sample visited ``(m, 2)``; places ``(n, m, 2)`` and agreement
            ``(n, m)`` to fill.
    """
    level, side = state
    index, order = samples
    shape, tables, fit_tables, nearest = discs
    start, places, agreement = out
    flat = (level.ravel(), side.ravel())
    flat_steps = (steps[0].ravel(), steps[1].ravel())
    drawn, owner = np.zeros(level.shape, np.float32), np.full(level.shape, -1, np.int32)
    touched = np.empty(level.size, np.int64)
    sums = np.zeros(7)
    center, speed = start.copy(), np.zeros(start.shape)
    before = center.copy()
    at = index[order[0]]
    for sample in order:
        move_kernel(flat, events, flat_steps, at, index[sample])
        at = index[sample]
        before[:] = center
        for m in range(len(shape)):
            center[m] += speed[m]
            scene = (before, nearest, shape, fit_tables)
            agreement[sample, m] = fit_kernel(state, steps, m, center[m], scene, sums)
        lead_kernel(center, start, agreement[sample], nearest)
        speed[:] = SPEED_KEPT * (center - before)
        places[sample] = center
        count = draw_kernel(center, (shape, tables), (drawn, owner), touched)
        pull_kernel(flat[0], drawn.ravel(), flat_steps)
        for i in range(count):
            drawn.ravel()[touched[i]] = 0.0
            owner.ravel()[touched[i]] = -1
