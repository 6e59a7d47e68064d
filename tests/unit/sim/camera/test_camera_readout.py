import numpy as np
import pytest

from spikingtac.sim.camera.config import ReadoutConfig
from spikingtac.sim.camera.pixel_records import KEY_SHIFT
from spikingtac.sim.camera.readout import Arbiter, Readout, arbitrate_kernel
from spikingtac.types import EventPacket, LossCounters

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


def arbiter(event_us, row_us=0.0, backlog_us=1000.0, loss=0.0) -> Arbiter:
    return Arbiter(
        event_us=event_us,
        row_us=row_us,
        backlog_us=backlog_us,
        loss=loss,
        width=SIZE[0],
        free_us=np.full(1, -np.inf),
        row=np.full(1, -1, np.int64),
        served=np.zeros(1, np.uint64),
        key=np.uint64(9),
    )


def served(events, event_us, row_us, backlog_us):
    """Plain Python server: one event at a time, in order."""
    out, dropped, free, last_row = [], 0, -np.inf, -1
    for key in events.tolist():
        t, code = key >> KEY_SHIFT, key & ((1 << KEY_SHIFT) - 1)
        row = (code >> 1) // SIZE[0]
        start = max(float(t), free)
        if start - t > backlog_us:
            dropped += 1
            continue
        if row != last_row:
            start, last_row = start + row_us, row
        free = start + event_us
        out.append((int(start) << KEY_SHIFT) | code)
    return out, dropped


@pytest.mark.parametrize(
    ("event_us", "row_us", "backlog_us"), [(0.1, 0.0, 1e3), (0.5, 0.25, 50.0), (3.0, 1.0, 5.0)]
)
@pytest.mark.parametrize("count", [0, 1, 2000])
def test_the_arbiter_equals_its_plain_twin(event_us, row_us, backlog_us, count):
    events = np.sort(random_keys(count, 1000))
    out = np.empty(count, np.int64)
    kept, dropped, lost = arbitrate_kernel(events, arbiter(event_us, row_us, backlog_us), out)
    expected, expected_dropped = served(events, event_us, row_us, backlog_us)
    assert out[:kept].tolist() == expected
    assert (dropped, lost) == (expected_dropped, 0)


def test_without_limits_events_only_come_into_order():
    station, losses = readout()
    events = random_keys(500, 1000)
    station.collect(events)
    np.testing.assert_array_equal(station.release(1000), np.sort(events))
    assert dict(losses) == {}


def test_a_burst_is_spread_to_the_cap_and_goes_on_in_the_next_interval():
    station, losses = readout(cap_mev_s=1.0, backlog_us=1e4)
    station.collect(random_keys(3000, 100))
    first, second = station.release(1000), station.release(10_000)
    assert (len(first) + len(second), len(losses)) == (3000, 0)
    times = np.concatenate([first, second]) >> KEY_SHIFT
    assert (first >> KEY_SHIFT).max() < 1000 <= (second >> KEY_SHIFT).min()
    assert (np.diff(times) >= 0).all()
    assert np.bincount(times).max() <= 2  # one a microsecond, cut at whole ones


def test_what_would_wait_too_long_is_dropped_and_counted():
    station, losses = readout(cap_mev_s=1.0, backlog_us=100.0)
    station.collect(random_keys(3000, 100))
    kept = len(station.release(10_000))
    assert losses["readout_overflow"] == 3000 - kept
    assert 150 < kept < 250


def test_random_loss_is_as_set_and_counted():
    station, losses = readout(loss=0.3)
    station.collect(random_keys(20_000, 1000))
    kept = len(station.release(1000))
    assert kept / 20_000 == pytest.approx(0.7, abs=0.015)
    assert losses["readout_loss"] == 20_000 - kept


def test_rounding_never_puts_an_event_before_its_interval():
    station, _ = readout()
    station.release(1000)
    station.collect(keys([999, 1000, 1200], [5, 4, 3], [7, 7, 7], [1, 1, 0]))
    assert (station.release(2000) >> KEY_SHIFT).tolist() == [1000, 1000, 1200]


def test_a_packet_unpacks_place_polarity_and_time():
    station, _ = readout()
    packet = station.packet([keys([3, 8], [63, 0], [0, 47], [1, 0])], 0, 10)
    assert isinstance(packet, EventPacket)
    assert packet.x.tolist() == [63, 0]
    assert packet.y.tolist() == [0, 47]
    assert packet.p.tolist() == [True, False]
    assert packet.t.tolist() == [3, 8]
    assert packet.x.dtype == np.uint16
    assert packet.t.dtype == np.int64
