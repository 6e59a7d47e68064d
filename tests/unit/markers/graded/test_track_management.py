from __future__ import annotations

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.markers.graded import track_management as track_management
from spikingtac.markers.graded.track_management import TrackManagementConfig, TrackManager
from spikingtac.markers.neighbours import Neighbourhood
from spikingtac.state_map.paint import paint_discs

SIZE = (160, 150)
REST_PX = np.stack(np.meshgrid(np.arange(4) * 34.0 + 25, np.arange(4) * 33.0 + 22), -1)
REST_PX = REST_PX.reshape(-1, 2)
RADIUS_PX = np.full(16, 6.0)
CALIBRATION = Calibration(reference_px=REST_PX, radius_px=RADIUS_PX, grid=(4, 4), size=SIZE)
AGREED = np.ones(16)
HEARD = np.zeros(16, np.bool_)
LATER_US = 100_000


def levels(center_px: np.ndarray) -> np.ndarray:
    return paint_discs(SIZE, center_px, RADIUS_PX[: len(center_px)])


def doubtful(marker: int) -> np.ndarray:
    agreement = AGREED.copy()
    agreement[marker] = 0.1
    return agreement


def test_all_is_well_at_rest() -> None:
    manager = TrackManager(TrackManagementConfig(), CALIBRATION)
    for t_us in range(0, LATER_US, 10_000):
        assert not manager.judge(t_us, REST_PX, AGREED, levels(REST_PX), HEARD).any()
        assert not manager.moved.any()


def test_doubt_needs_patience() -> None:
    manager = TrackManager(TrackManagementConfig(patience_us=20_000), CALIBRATION)
    nothing_there = levels(np.delete(REST_PX, 5, axis=0))
    assert not manager.judge(0, REST_PX, doubtful(5), nothing_there, HEARD).any()
    assert not manager.judge(10_000, REST_PX, doubtful(5), nothing_there, HEARD).any()
    held = manager.judge(20_000, REST_PX, doubtful(5), nothing_there, HEARD)
    assert np.flatnonzero(held).tolist() == [5]


def test_a_lost_marker_is_predicted_from_its_neighbours() -> None:
    manager = TrackManager(TrackManagementConfig(), CALIBRATION)
    moved_px = REST_PX + np.array([5.0, -3.0])
    blind = levels(np.delete(moved_px, 5, axis=0))
    fitted_px = moved_px.copy()
    fitted_px[5] = REST_PX[5] + [-4.0, 7.0]
    for t_us in (0, LATER_US, 2 * LATER_US):
        manager.judge(t_us, fitted_px, doubtful(5), blind, HEARD)
    assert manager.coasted[5]
    assert manager.moved[5]
    np.testing.assert_allclose(manager.position_px[5], moved_px[5], atol=0.2)


def test_a_marker_that_reappears_near_its_prediction_is_found_again() -> None:
    manager = TrackManager(TrackManagementConfig(), CALIBRATION)
    blind = levels(np.delete(REST_PX, 5, axis=0))
    for t_us in (0, LATER_US):
        manager.judge(t_us, REST_PX, doubtful(5), blind, HEARD)
    assert manager.coasted[5]
    back_px = REST_PX.copy()
    back_px[5] += [3.0, 2.0]
    manager.judge(2 * LATER_US, REST_PX, doubtful(5), levels(back_px), HEARD)
    assert not manager.coasted.any()
    np.testing.assert_allclose(manager.position_px[5], back_px[5], atol=0.2)


def test_a_blob_between_two_places_is_not_a_marker_that_came_back() -> None:
    """Half a pitch away it might be a reflection, or another marker's: it stays coasted."""
    manager = TrackManager(TrackManagementConfig(), CALIBRATION)
    half_a_pitch_px = np.array([17.0, 0.0])
    stray_px = REST_PX.copy()
    stray_px[5] += half_a_pitch_px
    for t_us in (0, LATER_US, 2 * LATER_US, 3 * LATER_US):
        manager.judge(t_us, REST_PX, doubtful(5), levels(stray_px), HEARD)
    assert np.flatnonzero(manager.coasted).tolist() == [5]
    np.testing.assert_allclose(manager.position_px[5], REST_PX[5], atol=0.2)


def test_a_neighbours_blob_is_never_taken() -> None:
    manager = TrackManager(TrackManagementConfig(capture_share=5.0), CALIBRATION)
    blind = levels(np.delete(REST_PX, 5, axis=0))
    for t_us in (0, LATER_US, 2 * LATER_US):
        manager.judge(t_us, REST_PX, doubtful(5), blind, HEARD)
    assert manager.coasted[5], "the only blobs belong to other markers"


def test_a_runaway_is_noticed_by_its_neighbours() -> None:
    manager = TrackManager(TrackManagementConfig(), CALIBRATION)
    fitted_px = REST_PX.copy()
    fitted_px[5] += [14.0, 0.0]
    for t_us in (0, LATER_US):
        manager.judge(t_us, fitted_px, AGREED, levels(REST_PX), HEARD)
    assert not manager.coasted.any(), "it was found again where it belongs"
    np.testing.assert_allclose(manager.position_px[5], REST_PX[5], atol=0.2)


def test_torsion_is_no_reason_for_doubt() -> None:
    manager = TrackManager(TrackManagementConfig(), CALIBRATION)
    offset = REST_PX - REST_PX.mean(axis=0)
    angle = np.radians(35.0) * np.exp(-((offset**2).sum(axis=1)) / (2 * 35.0**2))
    turn = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], axis=1)
    twisted_px = REST_PX.mean(axis=0) + np.einsum("mij,mj->mi", turn.reshape(-1, 2, 2), offset)
    for t_us in (0, LATER_US):
        assert not manager.judge(t_us, twisted_px, AGREED, levels(twisted_px), HEARD).any()


@pytest.mark.parametrize(
    "wrong",
    [{"agreement": 0.0}, {"strain_px": -1.0}, {"capture_share": 0.0}, {"patience_us": -1}],
)
def test_unfit_settings_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigError):
        TrackManagementConfig(**wrong)  # type: ignore[arg-type]


def test_a_silent_marker_is_held_and_not_found_in_its_own_painted_disc() -> None:
    manager = TrackManager(TrackManagementConfig(), CALIBRATION)
    silent = HEARD.copy()
    silent[5] = True
    for t_us in range(0, LATER_US, 10_000):
        held = manager.judge(t_us, REST_PX, AGREED, levels(REST_PX), silent)
        assert np.flatnonzero(held).tolist() == [5]
    for t_us in range(LATER_US, 2 * LATER_US, 10_000):
        manager.judge(t_us, REST_PX, AGREED, levels(REST_PX), HEARD)
    assert not manager.coasted.any()


def test_the_kernel_does_what_its_plain_twin_does() -> None:
    rng = np.random.default_rng(9)
    neighbours = Neighbourhood(REST_PX)
    seen = set()
    for spread_px in (0.1, 2.0, 5.0):
        for _ in range(20):
            fitted_px = REST_PX + rng.normal(0.0, spread_px, REST_PX.shape)
            agreement, silent = rng.uniform(0.3, 1.0, 16) ** 0.2, rng.random(16) < 0.01
            doubted = np.zeros(16, np.bool_)
            clear = track_management._all_clear_kernel(
                fitted_px,
                REST_PX,
                neighbours.index,
                neighbours.weight,
                agreement,
                silent,
                (0.8, 4.0, 0.3),
                doubted,
            )
            strain = np.hypot(*(fitted_px - neighbours.expected_px(fitted_px)).T)
            travel = np.hypot(*(fitted_px - REST_PX).T)[neighbours.index].max(axis=1)
            expected = (agreement < 0.8) | (strain > 4.0 + 0.3 * travel)
            np.testing.assert_array_equal(doubted, expected)
            assert clear == (not expected.any() and not silent.any())
            seen.add(clear)
    assert seen == {True, False}


@pytest.mark.parametrize(("pitch_px", "doubted"), [(30.0, True), (64.0, False)])
def test_strain_is_believed_in_proportion_to_the_pitch(pitch_px: float, doubted: bool) -> None:
    rest_px = np.stack(np.meshgrid(*2 * [np.arange(3) * pitch_px + 15.0]), -1).reshape(-1, 2)
    calibration = Calibration(
        reference_px=rest_px, radius_px=np.full(9, 6.0), grid=(3, 3), size=SIZE
    )
    manager = TrackManager(TrackManagementConfig(), calibration)
    pressed_px = rest_px.copy()
    pressed_px[4] += [10.0, 0.0]
    for t_us in (0, LATER_US):
        manager.judge(
            t_us,
            pressed_px,
            np.ones(9),
            paint_discs(SIZE, pressed_px, calibration.radius_px),
            np.zeros(9, np.bool_),
        )
    assert manager.coasted[4] == doubted
