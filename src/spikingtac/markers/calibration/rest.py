"""When the skin rests: stretches in which the sensor fires no more than its own noise.

A static press is as silent as no contact, so a stretch of silence is only a candidate; where the
markers stand in it decides (:mod:`spikingtac.markers.calibration.reference`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.markers.calibration.slides import Slides


@dataclass(frozen=True, kw_only=True, slots=True)
class RestConfig:
    """How silence is told from motion; all values are ours.

    Attributes:
        bin_us: Events are counted in bins of this length. 10 ms hold a hundred events of a quiet
            320x320 sensor at 0.1 Hz/px.
        quiet_share: A bin is quiet up to this share of the way from the quietest to the busy ones.
        quiet_percentile: Percentile of the bins' counts that stands for the noise alone.
        busy_percentile: The same for motion.
        shortest_us: A rest lasts at least this long; a slide turns round in less.
        settled_share: Which last part of a rest is used: the skin creeps at its beginning.
    """

    bin_us: int = 10_000
    quiet_share: float = 0.05
    quiet_percentile: float = 2.0
    busy_percentile: float = 75.0
    shortest_us: int = 60_000
    settled_share: float = 0.5

    def __post_init__(self) -> None:
        if self.bin_us < 1 or self.shortest_us < self.bin_us:
            raise ConfigError(
                f"bin_us {self.bin_us} and shortest_us {self.shortest_us} must be positive and in "
                "this order"
            )
        if not 0.0 < self.settled_share <= 1.0:
            raise ConfigError(f"settled_share is {self.settled_share}, valid is 0 < share <= 1")


def find_rests(slides: Slides, config: RestConfig) -> NDArray[np.int64]:
    """Return ``(n, 2)`` first and last time of each rest's settled part, us since the start.

    Where the recording begins silent, the whole of that first rest is kept: nothing creeps yet.
    """
    bins = max(1, slides.duration_us // config.bin_us)
    edges_us = np.arange(bins + 1, dtype=np.int64) * config.bin_us
    counts = np.diff(slides.index_at(edges_us)).astype(float)
    floor, busy = np.percentile(counts, (config.quiet_percentile, config.busy_percentile))
    # Three sigma of Poisson noise: counts above the floor's own scatter are motion.
    limit = floor + max(config.quiet_share * (busy - floor), 3.0 * np.sqrt(floor))
    quiet = np.concatenate([[False], counts <= limit, [False]])
    begins = np.flatnonzero(~quiet[:-1] & quiet[1:])
    ends = np.flatnonzero(quiet[:-1] & ~quiet[1:])
    long = (ends - begins) * config.bin_us >= config.shortest_us
    begins, ends = begins[long], ends[long]
    settled = ends - np.ceil(config.settled_share * (ends - begins)).astype(int)
    settled[begins == 0] = 0
    return np.column_stack([edges_us[settled], edges_us[ends]])
