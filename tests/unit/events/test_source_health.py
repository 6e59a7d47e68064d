"""Five counters tell the health of a stream, whatever its packing."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.events.formats.codec import HARMLESS, KINDS
from spikingtac.events.source import SLOT_US, HealthMeter, slot_rate_ev_s, source_health
from spikingtac.types import EventPacket

SIZE = (8, 8)


def packet(t: np.ndarray, start_us: int, end_us: int) -> EventPacket:
    zero = np.zeros(len(t), np.uint16)
    return EventPacket(zero, zero, zero > 0, t.astype(np.int64), start_us, end_us, SIZE, True)


def times(seed: int, end_us: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.sort(rng.integers(30_000, end_us, 2_000))


def counted_rate(t: np.ndarray, at_us: int, first_us: int) -> float:
    """The definition, one event at a time."""
    until_us = at_us - at_us % SLOT_US
    from_us = max(until_us - SLOT_US, first_us)
    inside = sum(1 for time_us in t.tolist() if from_us <= time_us < until_us)
    return inside / ((until_us - from_us) * 1e-6) if until_us > from_us else 0.0


@pytest.mark.parametrize("step_us", [1_000, 2_857, 33_333, 100_000, 250_000])
def test_the_rate_is_that_of_the_latest_full_slot_whatever_the_packing(step_us: int) -> None:
    t = times(step_us, 900_000)
    meter = HealthMeter({})
    for start_us in range(30_000, 900_000, step_us):
        end_us = start_us + step_us
        meter.absorb(packet(t[(t >= start_us) & (t < end_us)], start_us, end_us))
        expected = counted_rate(t, end_us, 30_000)
        assert meter.now().rate_ev_s == pytest.approx(expected)
        direct = slot_rate_ev_s(
            end_us, 30_000, lambda first, last: int(np.count_nonzero((t >= first) & (t < last)))
        )
        assert direct == pytest.approx(expected)
    whole = HealthMeter({})
    whole.absorb(packet(t, 30_000, 900_000))
    assert whole.total().rate_ev_s == pytest.approx(2_000 / 0.87)


def test_every_kind_of_loss_is_in_one_counter_and_what_loses_nothing_in_none() -> None:
    for kind in KINDS:
        found = source_health({kind: 3})
        counts = (found.gaps, found.overflows, found.damaged, found.reconnects)
        assert sum(counts) == (0 if kind in HARMLESS else 3), kind
    told = source_health(
        {"gap": 1, "disconnected": 2, "overflow": 4, "reconnected": 5, "garbage": 6}
    )
    assert (told.gaps, told.overflows, told.reconnects, told.damaged) == (3, 4, 5, 6)
