"""A sequential test over many time scales, and what it tells of a contact's place and onset.

A sequential test over many time scales: is the sum of the last n windows too large for chance?

A motion that begins at an unknown time and runs at an unknown speed shows best in the sum since its
beginning. The generalised likelihood ratio over the time of change is therefore the largest of the
whitened squared sums; testing n = 1, 2, 4, ... loses at most a factor of sqrt(2) in time (Lai,
"Sequential change-point detection in quality control and dynamical systems", J. R. Stat. Soc. B 57,
1995, window-limited rules).

Describe a contact: its place on the gel, its direction, and its onset.

Stopping an arm needs none of this. The detector works it out on request, after the decision.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.contact.detector import GelTouch

Vector = NDArray[np.float64]


class ScaleTest(NamedTuple):
    """The tests of all time scales, ready to be applied.

    Attributes:
        windows: ``int64[s]`` how many windows each scale sums, increasing.
        whiten: ``(s, d, length)`` maps the evidence of a scale to d numbers, each of variance 1 or
            less without contact.
        mean: ``(length,)`` evidence per window without contact.
        threshold: ``(s,)`` squared length that calls a contact.
    """

    windows: NDArray[np.int64]
    whiten: Vector
    mean: Vector
    threshold: Vector


class ScaleSums:
    """Keeps running sums of the evidence, and applies the tests to them.

    Args:
        test: The tests.
    """

    def __init__(self, test: ScaleTest) -> None:
        self._test = test
        self._ring = np.zeros((int(test.windows[-1]) + 1, test.whiten.shape[2]))
        self._values = np.zeros(len(test.windows))
        self._seen = 0

    def add(self, evidence: Vector) -> Vector:
        """Take the evidence of the next window; return the statistic of each scale.

        Scales longer than the time since the start have the statistic 0. The next call overwrites
        the array.
        """
        test = self._test
        self._seen = scales_kernel(
            evidence, test.windows, test.whiten, test.mean, self._ring, self._seen, self._values
        )
        return self._values

    def total(self, scale: int) -> Vector:
        """Return the evidence ``(length,)`` of the windows that a scale sums now."""
        now = self._seen % len(self._ring)
        start = (self._seen - int(self._test.windows[scale])) % len(self._ring)
        return self._ring[now] - self._ring[start]

    def course(self, along: Vector) -> Vector:
        """Return the running sum along a direction ``(n + 1,)`` over all kept windows."""
        kept = min(self._seen, len(self._ring) - 1)
        slots = np.arange(self._seen - kept, self._seen + 1) % len(self._ring)
        return self._ring[slots] @ along

    def reset(self) -> None:
        """Forget all sums."""
        self._ring[:] = 0.0
        self._seen = 0


@njit(cache=True)
def scales_kernel(
    evidence: Vector,
    windows: NDArray[np.int64],
    whiten: Vector,
    mean: Vector,
    ring: Vector,
    seen: int,
    values: Vector,
) -> int:
    """Add a window to the ring of running sums; write each scale's squared whitened sum.

    Returns:
        The number of windows so far, this one included.
    """
    slots = ring.shape[0]
    before, now = seen % slots, (seen + 1) % slots
    for part in range(len(evidence)):
        ring[now, part] = ring[before, part] + evidence[part] - mean[part]
    seen += 1
    for scale in range(len(values)):
        values[scale] = 0.0
        if windows[scale] > seen:
            continue
        start = (seen - windows[scale]) % slots
        for row in range(whiten.shape[1]):
            total = 0.0
            for part in range(len(evidence)):
                total += whiten[scale, row, part] * (ring[now, part] - ring[start, part])
            values[scale] += total * total
    return seen


@njit(cache=True)
def exceeded_kernel(values: Vector, threshold: Vector) -> int:
    """Return the scale that exceeds its threshold by the largest factor, or -1 for none."""
    best, highest = -1, 1.0
    for scale in range(len(values)):
        ratio = values[scale] / threshold[scale]
        if ratio > highest:
            best, highest = scale, ratio
    return best


# A marker counts as moved where its squared evidence exceeds that of noise by this factor. Under
# noise alone the ratio is exponentially distributed: 1 in 150 by chance.
MOVED_RATIO = 5.0


def gel_touch(evidence: Vector, center_px: Vector, noise: float) -> GelTouch | None:
    """Return place and direction from the markers' evidence, or None where no marker moved.

    Args:
        evidence: ``(m, 2)`` sum of each marker's evidence since the onset.
        center_px: ``(m, 2)`` centres of the markers, px.
        noise: Expected squared length of a marker's evidence without contact.
    """
    power = (evidence**2).sum(axis=1)
    weight = np.maximum(power - MOVED_RATIO * noise, 0.0)
    moved = weight > 0.0
    if not moved.any():
        return None
    weight = weight / weight.sum()
    place = weight @ center_px
    unit = evidence / np.sqrt(np.maximum(power, np.finfo(float).tiny))[:, None]
    away = center_px - place
    arm = weight @ np.hypot(away[:, 0], away[:, 1])
    moment = weight @ (away[:, 0] * unit[:, 1] - away[:, 1] * unit[:, 0])
    push = weight @ unit
    return GelTouch(
        place_px=(float(place[0]), float(place[1])),
        push=(float(push[0]), float(push[1])),
        turn=float(moment / arm) if arm > 0.0 else 0.0,
        markers=int(moved.sum()),
    )


def likeliest_onset(progress: Vector) -> int:
    """Return the maximum-likelihood onset of a drift that lasts to the end, in windows.

    For Gaussian sums the likeliest time of change is the minimum of the running sum less a
    reference drift (Page, Biometrika 41, 1954). The reference is half the mean drift since then.

    Args:
        progress: ``(n + 1,)`` running sum along the contact's direction, from 0 windows on.
    """
    lowest = int(progress.argmin())
    slope = (progress[-1] - progress[lowest]) / max(len(progress) - 1 - lowest, 1)
    return int((progress - 0.5 * slope * np.arange(len(progress))).argmin())
