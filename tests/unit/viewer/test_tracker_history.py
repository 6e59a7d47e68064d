import numpy as np
import pytest

from spikingtac.viewer.replay import tracker_history as module
from spikingtac.viewer.replay.tracker_history import TrackerHistory

STEP_US = 1_000
PIXELS = 10_000


class State:
    """A constant table, a map of which every step changes one pixel, and an array made anew."""

    def __init__(self) -> None:
        self.table = np.linspace(0, 1, PIXELS)
        self.table[0] = np.nan
        self.map = np.zeros(PIXELS)
        self.also_map = self.map
        self.fresh = np.zeros(3)
        self.steps = 0

    def step(self) -> None:
        self.map[self.steps % PIXELS] += 1
        self.fresh = np.full(3, float(self.steps))
        self.steps += 1


def run(kept: TrackerHistory[State], state: State, first: int, last: int) -> None:
    for step in range(first, last):
        state.step()
        kept.offer((step + 1) * STEP_US, 0, state)


@pytest.fixture(autouse=True)
def every_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FIRST_DISTANCE_US", STEP_US)


def test_what_does_not_change_is_stored_once() -> None:
    kept, state = TrackerHistory[State](), State()
    run(kept, state, 0, 20)
    table, map_ = state.table.nbytes, state.map.nbytes
    assert kept.kept_bytes == table + 20 * (map_ + state.fresh.nbytes)
    found = kept.before(20 * STEP_US)  # and so it is after going back
    assert found is not None
    run(kept, found[1], 20, 30)
    assert kept.kept_bytes == table + 30 * (map_ + state.fresh.nbytes)


def test_the_bytes_stay_below_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_BYTES", 10 * PIXELS * 8)
    kept, state = TrackerHistory[State](), State()
    for step in range(0, 500, 50):
        run(kept, state, step, step + 50)
        assert kept.kept_bytes <= module.MOST_BYTES
        assert len(kept) >= 3
    assert kept.distance_us > 50 * STEP_US
