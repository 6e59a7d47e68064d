"""Steps grow where the tracker lags, and stay where it does not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.calibration.buffered_events import BufferedEvents
from spikingtac.markers.calibration.step_scale import fit_step_scale
from spikingtac.markers.profile import DiscProfile

SIZE = (96, 64)
REST_PX = np.array([[24.0, 20.0], [60.0, 20.0], [24.0, 46.0], [60.0, 46.0]])
RADIUS_PX, STEP, PERIOD_US = 6.0, 0.12, 1_000
PROFILE = DiscProfile(4.0, 0.7)


def ways_px() -> np.ndarray:
    phase = np.linspace(0.0, 6.0 * np.pi, 1_500)
    return np.column_stack([8.0 * np.sin(phase), 5.0 * np.sin(0.5 * phase)])


def levels(way_px: np.ndarray) -> np.ndarray:
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    out = np.zeros((SIZE[1], SIZE[0]))
    for cx, cy in REST_PX + way_px:
        np.maximum(out, PROFILE.level(np.hypot(x - cx, y - cy) - RADIUS_PX), out=out)
    return out


def fired() -> Iterator[tuple[int, np.ndarray]]:
    """Yield time and codes of ideal pixels that follow the discs."""
    known = levels(ways_px()[0]).ravel()
    for sample, way_px in enumerate(ways_px()):
        now = levels(way_px).ravel()
        for sign, bit in ((1.0, 1), (-1.0, 0)):
            while len(pixels := np.flatnonzero(sign * (now - known) > STEP)):
                known[pixels] += sign * STEP
                yield sample * PERIOD_US, 2 * pixels + bit


@pytest.fixture(scope="module")
def events() -> BufferedEvents:
    times, codes = zip(*fired(), strict=True)
    stamps = np.repeat(times, [len(code) for code in codes])
    code = np.concatenate(codes).astype(np.uint32)
    return BufferedEvents(code, stamps.astype(np.uint32), SIZE, 0, 1_500 * PERIOD_US)


def calibration(step: float) -> Calibration:
    return Calibration(
        reference_px=REST_PX,
        radius_px=np.full(4, RADIUS_PX),
        grid=(2, 2),
        size=SIZE,
        contrast=PROFILE.contrast,
        edge_px=PROFILE.edge_px,
        step_on=step,
        step_off=step,
        lag_us=0.0,
    )


def known_places(events: BufferedEvents) -> tuple[np.ndarray, np.ndarray]:
    samples = np.arange(50, 1_500, 50)
    index = events.index_at(samples * PERIOD_US)
    return index, REST_PX + ways_px()[samples][:, np.newaxis]


def test_right_steps_stay(events: BufferedEvents) -> None:
    on, off = fit_step_scale(events, calibration(STEP), known_places(events))
    assert max(on, off) < 1.3


def test_small_steps_grow(events: BufferedEvents) -> None:
    on, off = fit_step_scale(events, calibration(STEP / 2.5), known_places(events))
    assert min(on, off) > 1.5


def test_markers_that_were_not_measured_do_not_count(events: BufferedEvents) -> None:
    index, places_px = known_places(events)
    wrong_px = places_px.copy()
    wrong_px[:, 3] += 30.0
    measured = replace(calibration(STEP), marker_measured=np.arange(4) < 3)
    assert fit_step_scale(events, measured, (index, wrong_px)) == fit_step_scale(
        events, measured, (index, places_px)
    )


def test_every_kind_of_step_is_scaled_up_to_one() -> None:
    maps = np.array([[0.0, 0.3], [0.6, 0.9]], np.float32)
    own = replace(
        calibration(0.2),
        step_on_map=maps,
        step_off_map=maps,
        marker_step_on=np.full(4, 0.25),
        marker_step_off=np.full(4, 0.5),
    )
    scaled = own.with_steps_scaled(2.0, 1.0)
    assert (scaled.step_on, scaled.step_off) == (0.4, 0.2)
    assert scaled.step_on_map is not None
    assert scaled.marker_step_on is not None
    np.testing.assert_allclose(scaled.step_on_map, [[0.0, 0.6], [1.0, 1.0]])
    np.testing.assert_allclose(scaled.marker_step_on, 0.5)
    assert scaled.step_off_map is not None
    assert scaled.marker_step_off is not None
    np.testing.assert_allclose(scaled.step_off_map, maps)
    np.testing.assert_allclose(scaled.marker_step_off, 0.5)
