"""The count that quiet windows exceed as often as a budget allows."""

from __future__ import annotations

import pytest
from scipy import stats

from spikingtac.contact.quiet import SECONDS_PER_HOUR, QuietStatistics

WINDOWS, PERIOD_S = 10_000, 0.001


def quiet(mean: float, variance: float) -> QuietStatistics:
    return QuietStatistics(
        mean=mean, variance=variance, highest=0, windows=WINDOWS, period_s=PERIOD_S
    )


@pytest.mark.parametrize("alarms_per_hour", [0.01, 1.0, 36_000.0])
def test_the_least_count_is_that_of_the_distribution(alarms_per_hour: float) -> None:
    chance = alarms_per_hour * PERIOD_S / SECONDS_PER_HOUR
    for mean in (0.02, 0.7, 3.0, 41.5, 2_000.0):
        found = quiet(mean, mean).threshold(alarms_per_hour)
        assert found == int(stats.poisson.isf(chance, mean))
        for excess in (0.3, 2.0, 40.0):
            size = mean / excess
            found = quiet(mean, mean * (1.0 + excess)).threshold(alarms_per_hour)
            assert found == int(stats.nbinom.isf(chance, size, size / (size + mean)))
