import numpy as np
import pytest

from spikingtac.sim.camera_config import ReadoutConfig
from spikingtac.sim.pixels import KEY_SHIFT
from spikingtac.sim.readout import BACKLOG_US, Arbiter, Readout, arbitrate_kernel
from spikingtac.types import LossCounters

SIZE = (64, 48)


def keys(t_us, x, y, p) -> np.ndarray:
    t_us, x, y, p = (np.asarray(item, np.int64) for item in (t_us, x, y, p))
    return (t_us << KEY_SHIFT) | ((y * SIZE[0] + x) << 1) | p


def random_keys(count: int, span_us: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return keys(
        rng.integers(0, span_us, count),
        rng.integers(0, SIZE[0], count),
        rng.integers(0, SIZE[1], count),
        rng.integers(0, 2, count),
    )


def readout(**settings) -> tuple[Readout, LossCounters]:
    losses = LossCounters()
    return Readout(ReadoutConfig(**settings), SIZE, np.random.default_rng(1), losses), losses


def arbiter(event_us: float) -> Arbiter:
    return Arbiter(
        event_us=event_us,
        loss=0.0,
        free_us=np.full(1, -np.inf),
        served=np.zeros(1, np.uint64),
        key=np.uint64(9),
    )


def served(events, event_us):
    """Plain Python server: one event at a time, in order."""
    out, dropped, free = [], 0, -np.inf
    for key in events.tolist():
        t, code = key >> KEY_SHIFT, key & ((1 << KEY_SHIFT) - 1)
        start = max(float(t), free)
        if start - t > BACKLOG_US:
            dropped += 1
            continue
        free = start + event_us
        out.append((int(start) << KEY_SHIFT) | code)
    return out, dropped


@pytest.mark.parametrize("event_us", [0.1, 0.5, 3.0])
@pytest.mark.parametrize("count", [0, 1, 2000])
def test_the_arbiter_equals_its_plain_twin(event_us, count):
    events = np.sort(random_keys(count, 1000))
    out = np.empty(count, np.int64)
    kept, dropped, lost = arbitrate_kernel(events, arbiter(event_us), out)
    expected, expected_dropped = served(events, event_us)
    assert out[:kept].tolist() == expected
    assert (dropped, lost) == (expected_dropped, 0)
    assert (dropped > 0) == (event_us * count > 2 * BACKLOG_US)


def test_random_loss_is_as_set_and_counted():
    station, losses = readout(loss=0.3)
    station.collect(random_keys(20_000, 1000))
    kept = len(station.release(1000))
    assert kept / 20_000 == pytest.approx(0.7, abs=0.015)
    assert losses["readout_loss"] == 20_000 - kept
