"""Follow the markers through a recording, forwards and backwards.

Each pixel keeps the level at which it last fired. The true level lies within a band around it,
from one OFF step below to one ON step above, and most likely half a step beyond in the direction
of the last event. A disc is fitted to these levels at each sample by Gauss-Newton; then the levels
are drawn towards the bands that the discs allow, so that noise and wrong steps do not add up.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.calibration.disc_fits import Scene, fit_room, fit_some_kernel
from spikingtac.markers.calibration.disc_levels import (
    Course,
    Discs,
    PixelSteps,
    draw_kernel,
    nearest_markers,
)
from spikingtac.markers.calibration.recording import BufferedEvents
from spikingtac.state_map.two_threads import divide

PULL = 0.2  # Share of a band's violation that is taken away at each sample.

FEWEST_AGREEMENT = 0.45  # A disc is believed when so much of its edge agrees.

SPEED_KEPT = 0.8  # Share of the last step by which a marker is expected to go on.

LED_SHARE = 0.3  # Share by which a disc that is not believed is drawn to where its neighbours went.

MANY_DISCS = 48  # Fewer discs are fitted in the time that dividing them takes, 0.1 ms.


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
        events, flat_steps = self._events, (steps.on.ravel(), steps.off.ravel())
        images = state[0].reshape(events.shape), state[1].reshape(events.shape)
        room = np.zeros(events.shape, np.float32), np.full(events.shape, -1, np.int32)
        nearest, shape, tables = nearest_markers(start_px), discs.shape, discs.tables
        fit_tables, count = discs.fit_tables, (len(self._index), len(shape))
        found = Course(self._index, np.zeros((*count, 2)), np.zeros(count))
        center, speed = start_px.copy(), np.zeros_like(start_px)
        at = self._index[order[0]]
        for sample in order:
            until, agreement = self._index[sample], found.agreement[sample]
            move_kernel(state, (events.code, self._before), flat_steps, at, until)
            at, before = until, center.copy()
            center += speed
            scene = before, nearest, shape, fit_tables
            _fit(images, (steps.on, steps.off), center, scene, agreement)
            lead_kernel(center, start_px, agreement, nearest)
            speed = SPEED_KEPT * (center - before)
            found.center_px[sample] = center
            _pull(images[0], (steps.on, steps.off), center, (shape, tables), room)
        return found


def _fit(
    state: tuple[NDArray[np.float32], NDArray[np.int8]],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
    center: NDArray[np.float64],
    scene: Scene,
    agreement: NDArray[np.float64],
) -> None:
    # Move all discs to where they fit best, a part of them on a second core.
    def fit(chosen: slice) -> None:
        ends = chosen.start, chosen.stop
        fit_some_kernel(state, steps, ends, center, scene, (agreement, fit_room(scene[2])))

    _share(len(center), len(center), fit)


def _pull(
    level: NDArray[np.float32],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
    center: NDArray[np.float64],
    looks: tuple[NDArray[np.float64], NDArray[np.float32]],
    room: tuple[NDArray[np.float32], NDArray[np.int32]],
) -> None:
    # Draw all levels to what the discs allow, a part of the rows on a second core.
    def pull(rows: slice) -> None:
        own = center - [0.0, rows.start]
        some = steps[0][rows], steps[1][rows]
        pull_to_discs_kernel(level[rows], own, looks, some, (room[0][rows], room[1][rows]))

    _share(len(center), len(level), pull)


def _share(discs: int, count: int, work: Callable[[slice], None]) -> None:
    # The same parts on every machine: rows that are shifted round differently in the last digit.
    if discs < MANY_DISCS:
        work(slice(0, count))
    else:
        divide(count, work)


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
    """Draw discs of doubtful fits towards where their reliable neighbours went."""
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


@njit(cache=True, nogil=True)
def pull_to_discs_kernel(
    level: NDArray[np.float32],
    center: NDArray[np.float64],
    discs: tuple[NDArray[np.float64], NDArray[np.float32]],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
    room: tuple[NDArray[np.float32], NDArray[np.int32]],
) -> None:
    """Draw each level ``(height, width)`` towards the band that the discs allow.

    ``room`` is an empty image and its owners, -1 everywhere; both are left as they were.
    """
    drawn, owner = room
    expected, whose, touched = drawn.ravel(), owner.ravel(), np.empty(level.size, np.int64)
    count = draw_kernel(center, discs, (drawn, owner), touched)
    pull_kernel(level.ravel(), expected, (steps[0].ravel(), steps[1].ravel()))
    for i in range(count):
        expected[touched[i]] = 0.0
        whose[touched[i]] = -1
