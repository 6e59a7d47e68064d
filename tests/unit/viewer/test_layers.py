import numpy as np
import pytest

from spikingtac.config import load_config
from spikingtac.markers.registry import make_tracker
from spikingtac.types import EventPacket
from spikingtac.viewer import snapshot as layers
from spikingtac.viewer.snapshot import (
    AGE_BINS,
    OFF_CODE,
    activity,
    state_image,
    unpack,
    view_size,
)
from stand_ins.viewer import open_circling


def packet(size: tuple[int, int], n: int, seed: int = 1, span_us: int = 7_000) -> EventPacket:
    rng = np.random.default_rng(seed)
    return EventPacket(
        rng.integers(0, size[0], n).astype(np.uint16),
        rng.integers(0, size[1], n).astype(np.uint16),
        rng.random(n) < 0.5,
        np.sort(rng.integers(1_000, 1_000 + span_us, n)).astype(np.int64),
        1_000,
        1_000 + span_us,
        size,
    )


def plain_activity(events: EventPacket, step: int) -> np.ndarray:
    width, height = view_size(events.size)
    image = np.zeros((height, width), np.uint8)
    span_us = events.t_end_us - events.t_start_us
    for x, y, p, t in zip(events.x, events.y, events.p, events.t, strict=True):
        age = 1 + int(t - events.t_start_us) * AGE_BINS // span_us
        image[int(y) // step, int(x) // step] = age if p else age + OFF_CODE
    return image


@pytest.mark.parametrize(("size", "step"), [((6, 5), 1), ((320, 240), 1), ((1281, 721), 3)])
@pytest.mark.parametrize("n", [0, 1, 500])
def test_the_last_event_of_a_pixel_is_shown(size: tuple[int, int], step: int, n: int) -> None:
    events = packet(size, n)
    shown = unpack(activity(events), view_size(size))
    np.testing.assert_array_equal(shown, plain_activity(events, step))


def test_a_burst_shows_its_latest_events(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(layers, "MOST_EVENTS", 10)
    events = packet((50, 50), 400)
    shown = unpack(activity(events), (50, 50))
    assert 0 < np.count_nonzero(shown) <= 10


def test_state_map_levels() -> None:
    values = np.array([[0.0, 0.5, 1.0], [-0.2, 1.7, 0.03]])
    np.testing.assert_array_equal(unpack(state_image(values), (3, 2)), [[0, 8, 15], [0, 15, 0]])


def test_large_sensors_are_thinned() -> None:
    assert view_size((1280, 720)) == (640, 360)
    assert len(state_image(np.zeros((720, 1280)))) == 640 * 360 // 2


@pytest.mark.parametrize("preset", ["default", "fast", "paper"])
def test_every_preset_shows_the_map_that_it_tracks_on(preset: str) -> None:
    view = open_circling(duration_us=10_000)
    tracker = make_tracker(load_config(preset).tracking, view.calibration)
    painted = tracker.state_map.values.copy()
    for packet in view.source:
        tracker.absorb(packet)
    assert painted.shape == (320, 320)
    assert (tracker.state_map.values != painted).any()
