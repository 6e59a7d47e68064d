"""The graded map over slides, forwards and backwards in time.

Brightness can be integrated either way: undoing the events of a stretch, last first, leads from the
map at its end to that at its beginning. Clipping at both ends anchors the map in either direction,
so that the rest before the first slide, free of the skin's creep, can be seen with a map that all
later slides filled.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.calibration.contrast_steps import ContrastSteps
from spikingtac.markers.calibration.slides import Slides
from spikingtac.state_map.graded import OUTSIDE_LEVEL, PAD_PX


class SlideMap:
    """A graded map that is moved along the slides, in one direction.

    Args:
        slides: The recording.
        steps: What one event of each pixel stands for.
        backward: Whether it begins at the end.
        level: ``(height, width)`` map to begin with; None is the empty map.

    Attributes:
        padded: ``(height + 2 PAD_PX, width + 2 PAD_PX)`` float32: ``values`` in a margin of
            OUTSIDE_LEVEL, as the disc fit reads it.
    """

    def __init__(
        self,
        slides: Slides,
        steps: ContrastSteps,
        *,
        backward: bool = False,
        level: NDArray[np.float32] | None = None,
    ) -> None:
        pixels = slides.size[0] * slides.size[1]
        self._slides, self._backward = slides, backward
        self._on, self._off = steps.on.ravel(), steps.off.ravel()
        self._level = np.zeros(pixels, np.float32) if level is None else level.ravel().copy()
        self._side = np.zeros(pixels, np.int8)
        self._at = len(slides) if backward else 0
        self._before = np.empty(len(slides) if backward else 0, np.int8)
        height, width = slides.shape
        self.padded = np.full((height + 2 * PAD_PX, width + 2 * PAD_PX), OUTSIDE_LEVEL)
        self._middle = self.padded[PAD_PX:-PAD_PX, PAD_PX:-PAD_PX]
        self._middle[:] = self._level.reshape(slides.shape)
        if backward:
            note_sides_kernel(slides.code, self._side, self._before)

    def move_to(self, index: int) -> None:
        """Go on to the state after the first ``index`` events; only in the map's direction."""
        if self._backward:
            part = slice(index, self._at)
            undo_kernel(
                self._level,
                self._side,
                self._slides.code[part],
                self._before[part],
                (self._on, self._off),
            )
        else:
            part = slice(self._at, index)
            code = self._slides.code[part]
            absorb_kernel(self._level, self._side, code, (self._on, self._off))
        self._at = index
        middle_kernel(self._level, self._side, (self._on, self._off), self._middle)

    @property
    def level(self) -> NDArray[np.float32]:
        """``(height, width)`` from 0 to 1, a copy: where each pixel's reference level stands."""
        return self._level.reshape(self._slides.shape).copy()

    def order(self, count: int) -> range:
        """Return the indices of ``count`` times in the order in which this map meets them."""
        return range(count - 1, -1, -1) if self._backward else range(count)

    @property
    def values(self) -> NDArray[np.float32]:
        """``(height, width)`` from 0 to 1, a copy: the level, half a step towards the last event.

        Light that rose to a threshold went on rising, or stopped, before the next one: its mean is
        half a step above. Before a pixel's first event nothing is known, and the level stands.
        """
        return self.padded[PAD_PX:-PAD_PX, PAD_PX:-PAD_PX].copy()


@njit(cache=True)
def absorb_kernel(
    level: NDArray[np.float32],
    side: NDArray[np.int8],
    code: NDArray[np.uint32],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
) -> None:
    """Add each event's step to its pixel, clipped to [0, 1]; note its polarity as +1 or -1."""
    on, off = steps
    half, one = np.float32(0.5), np.float32(1.0)
    for i in range(len(code)):
        pixel = code[i] >> 1
        if code[i] & 1:
            level[pixel] = min(level[pixel] + on[pixel], one - half * off[pixel])
            side[pixel] = 1
        else:
            level[pixel] = max(level[pixel] - off[pixel], half * on[pixel])
            side[pixel] = -1


@njit(cache=True)
def note_sides_kernel(
    code: NDArray[np.uint32], side: NDArray[np.int8], before: NDArray[np.int8]
) -> None:
    """Note for each event the polarity of the one before it in its pixel, 0 for the first."""
    for i in range(len(code)):
        pixel = code[i] >> 1
        before[i] = side[pixel]
        side[pixel] = 1 if code[i] & 1 else -1


@njit(cache=True)
def undo_kernel(
    level: NDArray[np.float32],
    side: NDArray[np.int8],
    code: NDArray[np.uint32],
    before: NDArray[np.int8],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
) -> None:
    """Take each event's step back, last event first, clipped to [0, 1]; its pixel's side too."""
    on, off = steps
    half, one = np.float32(0.5), np.float32(1.0)
    for back in range(1, len(code) + 1):
        i = len(code) - back
        pixel = code[i] >> 1
        if code[i] & 1:
            level[pixel] = max(level[pixel] - on[pixel], half * on[pixel])
        else:
            level[pixel] = min(level[pixel] + off[pixel], one - half * off[pixel])
        side[pixel] = before[i]


@njit(cache=True)
def middle_kernel(
    level: NDArray[np.float32],
    side: NDArray[np.int8],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
    middle: NDArray[np.float32],
) -> None:
    """Write the expected light of each pixel, ``(height, width)``, clipped to [0, 1]."""
    on, off = steps
    half, zero, one = np.float32(0.5), np.float32(0.0), np.float32(1.0)
    height, width = middle.shape
    for y in range(height):
        for x in range(width):
            i = y * width + x
            up = half * on[i] * np.float32(side[i] > 0)
            down = half * off[i] * np.float32(side[i] < 0)
            middle[y, x] = min(max(level[i] + up - down, zero), one)
