"""At which events the calibration looks where the markers are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.calibration.finding.sighting import Look
from spikingtac.markers.calibration.reference import CREPT_SHARE

SAMPLE_PX = 0.5
"""Samples are so far apart that the markers move by this much between two, on the average. (Ours:
0.2 px is no better on simulated presses, and takes half as long again.)"""

FEWEST_SAMPLES, MOST_SAMPLES = 400, 6_000
"""Bounds of the samples: short recordings are sampled more finely, long ones more coarsely."""

FEWEST_FITS = 160_000
"""Short recordings of so many markers that this is exceeded are not sampled more finely. (Ours: of
1,024 markers, 160 samples are as good as 400.)"""

REST_SHARES = (CREPT_SHARE, 0.8, 0.95)
"""Where in a rest it is sampled. The skin creeps in its first part; the middle one stands for the
rest."""


def choose_samples(look: Look) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return how many events come before each sample, and which samples lie in rests.

    Args:
        look: The recording, and where its markers were seen at rest.

    Returns:
        ``(n,)`` numbers of events, increasing, and ``(rests, 3)`` the first, the typical and the
        last sample of each rest.
    """
    events = look.events
    # Both rims of a disc that moves by a pixel sweep its diameter, one up and one down a swing.
    diameter_px = 2.0 * look.sighting.radius_px * len(look.sighting.center_px)
    events_per_px = diameter_px * (1.0 / look.steps.on + 1.0 / look.steps.off)
    fewest = min(FEWEST_SAMPLES, FEWEST_FITS // len(look.sighting.center_px))
    apart = min(int(SAMPLE_PX * events_per_px), len(events) // max(fewest, 1))
    apart = max(apart, len(events) // MOST_SAMPLES, 1)
    begin_us, length_us = look.rests_us[:, :1], np.diff(look.rests_us, axis=1)
    rest = events.index_at((begin_us + length_us * np.array(REST_SHARES)).astype(np.int64))
    index = np.unique(
        np.concatenate([np.arange(0, len(events), apart), rest.ravel(), [len(events)]])
    )
    return index, np.searchsorted(index, rest)
