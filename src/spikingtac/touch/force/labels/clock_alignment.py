"""The offset between two clocks, from what both have seen: how much moves and how hard it presses.

Both are made uniform in time and correlated; the best offset is refined by a parabola. Contacts
that repeat alike at equal intervals are ambiguous: press once at an odd moment.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from spikingtac.errors import RecordingError
from spikingtac.touch.force.wrench_series import WrenchSeries

Field = NDArray[np.float64]

STEP_US = 5_000
"""Step of the common time, us: a fifth of the time in which the fastest press builds up (ours)."""
LEAST_CORRELATION = 0.6
"""Motion and force that agree less than this are of different recordings (ours)."""


def clock_offset_us(series: WrenchSeries, t_us: NDArray[np.int64], wrench: Field) -> int:
    """Return what must be added to the forces' times to get those of the displacements, us.

    Args:
        series: Displacements; its own wrench is not looked at.
        t_us: ``(k,)`` times of the forces on their own clock, us, increasing.
        wrench: ``(k, c)`` forces, N, in the first three columns.

    Raises:
        RecordingError: Motion and force do not look alike at any offset.
    """
    moved = np.sqrt((series.displacement**2).sum(axis=2).mean(axis=1))
    pressed = np.sqrt((wrench[:, :3] ** 2).sum(axis=1))
    seen, felt = _uniform(series.t_us, moved), _uniform(t_us, pressed)
    seen, felt = seen - seen.mean(), felt - felt.mean()
    scale = float(np.sqrt((seen**2).sum() * (felt**2).sum()))
    score = correlate(seen, felt) / (scale if scale > 0.0 else 1.0)
    best = int(score.argmax())
    if not score[best] >= LEAST_CORRELATION:
        raise RecordingError(
            f"{series.name}: displacements and forces agree by {score[best]:.2f} at best; "
            "are they of the same recording?"
        )
    steps = best - (len(felt) - 1) + _vertex(score, best)
    return int(series.t_us[0]) - int(t_us[0]) + round(steps * STEP_US)


def _uniform(t_us: NDArray[np.int64], values: Field) -> Field:
    return np.interp(np.arange(t_us[0], t_us[-1] + 1, STEP_US), t_us, values)


def _vertex(score: Field, best: int) -> float:
    """Return the place of a parabola's vertex beside the largest of its three points, in steps."""
    if not 0 < best < len(score) - 1:
        return 0.0
    left, top, right = score[best - 1 : best + 2]
    bend = left - 2.0 * top + right
    return float(0.5 * (left - right) / bend) if bend < 0.0 else 0.0
