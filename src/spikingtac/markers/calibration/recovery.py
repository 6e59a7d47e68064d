"""Whether pixels forget light that they lost without an event: OFF events that slow falls lack.

On the recorded sensor a disc that creeps on after a press sends ON events where it arrives and none
where it leaves, and a fast fall sends an OFF event more than a slow one. A pixel that explains both
gives up, within 0.2 s, whatever it is darker than at its last event; what it is brighter it keeps.
Then ON and OFF events stand for nearly the same step, and what looked like rare OFF events is slow
motion. Other sensors keep both: this one's refinement is kept only where it explains their events
better.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.calibration.recording import BufferedEvents
from spikingtac.markers.calibration.refine import MOST_ROUNDS, Refined, refine

# Time in which it is forgotten, s (the counts of the recorded sensor, pixel by pixel and burst by
# burst: 0.19 to 0.25; simulated: 0.1 to 0.4 instead of 0.2 cost 5 %).
RECOVERY_S = 0.2

# Share of ON events below which nothing is missing of the OFF events (the recorded sensor 0.75,
# simulated ones that recover 0.68 and 0.72, those whose thresholds are alike 0.51).
LEAST_ON_SHARE = 0.6

# Share by which the levels left over must shrink, the median over the markers (the recorded
# sensor 0.17, parts of it 0.13 to 0.24; simulated ones that recover 0.14 to 0.16, those that do
# not 0.08 at most; from four short presses it cannot be told).
RECOVERY_GAIN = 0.1

# After so many rounds it is given up where more than this share is left over (the recorded sensor
# 0.92, two simulated ones that do not recover 1.23 and 1.34; seven rounds more take off a tenth).
FIRST_ROUNDS, HOPELESS = 3, 1.1


def with_recovery(
    events: BufferedEvents,
    refined: Refined,
    still: NDArray[np.int64],
    cell: NDArray[np.int64],
    noise: NDArray[np.float64],
) -> Refined:
    """Return what explains the events better: pixels that recover, or ``refined``, without.

    The arguments are those of :func:`~spikingtac.markers.calibration.refine.refine`.
    """
    if float(np.mean(events.code & 1)) < LEAST_ON_SHARE:
        return refined
    about = still, cell, noise
    recovering = refine(events, replace(refined, recovery_s=RECOVERY_S), *about, FIRST_ROUNDS)
    if _left_over(recovering, refined) > HOPELESS:
        return refined
    recovering = refine(events, recovering, *about, MOST_ROUNDS - FIRST_ROUNDS)
    return recovering if _left_over(recovering, refined) < 1.0 - RECOVERY_GAIN else refined


def _left_over(recovering: Refined, refined: Refined) -> float:
    # Marker by marker: those that hardly move are explained as badly by both.
    seen = refined.residual > 0.0
    if not seen.any():
        return np.inf  # nothing moved, nothing recovers
    return float(np.median(recovering.residual[seen] / refined.residual[seen]))
