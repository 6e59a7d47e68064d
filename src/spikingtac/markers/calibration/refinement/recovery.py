"""Whether pixels forget light that they lost without an event: OFF events that slow falls lack.

On the recorded sensor a disc that creeps on after a press sends ON events where it arrives and none
where it leaves, and a fast fall sends an OFF event more than a slow one. A pixel that explains both
gives up, within 0.2 s, whatever it is darker than at its last event; what it is brighter it keeps.
Then ON and OFF events stand for nearly the same step, and what looked like rare OFF events is slow
motion. Other sensors keep both: this one's refinement is kept only where it explains their events
better. Ours.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.calibration.buffered_events import BufferedEvents
from spikingtac.markers.calibration.refinement.refine import Refined, refine

RECOVERY_S = 0.2
"""Time in which it is forgotten, s (the counts of the recorded sensor, pixel by pixel and burst by
burst: 0.19 to 0.25; simulated: 0.1 to 0.4 instead of 0.2 cost 5 %)."""

LEAST_ON_SHARE = 0.6
"""Share of ON events below which nothing is missing of the OFF events (the recorded sensor 0.75,
simulated ones that recover 0.68 and 0.72, those whose thresholds are alike 0.51)."""

LEAST_GAIN = 0.05
"""Share by which the levels left over must shrink: less is chance."""


def with_recovery(
    events: BufferedEvents,
    refined: Refined,
    still: NDArray[np.int64],
    cell: NDArray[np.int64],
    noise: NDArray[np.float64],
) -> Refined:
    """Return what explains the events better: pixels that recover, or ``refined``, without.

    The arguments are those of :func:`~spikingtac.markers.calibration.refinement.refine.refine`.
    """
    if float(np.mean(events.code & 1)) < LEAST_ON_SHARE:
        return refined
    recovering = refine(events, replace(refined, recovery_s=RECOVERY_S), still, cell, noise)
    before, after = (float(np.median(one.residual)) for one in (refined, recovering))
    return recovering if after < (1.0 - LEAST_GAIN) * before else refined
