"""Pitch, scale and lens of a flat grid, against Brown's distortion in the digital twin."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.lens import SkinScale, fit_lens, marker_pitch_px
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import CalibrationError, ConfigError, RecordingError
from spikingtac.markers.calibration.calibrate import with_lens
from spikingtac.sim.optics import Optics, OpticsConfig
from spikingtac.sim.scene import SkinConfig
from spikingtac.tracks.comparison import compare_with_truth
from spikingtac.tracks.tracks import Tracks
from stand_ins.known import known

pytestmark = pytest.mark.usefixtures("discs_in_their_places")

SIZE, GRID, PITCH_MM = (320, 320), (8, 8), 2.4
NOISE_PX = 0.05


def skin_mm(grid: tuple[int, int] = GRID) -> np.ndarray:
    y, x = np.mgrid[0 : grid[0], 0 : grid[1]] * PITCH_MM
    return np.stack([x.ravel() - x.mean(), y.ravel() - y.mean()], axis=1)


def imaged_px(place_mm: np.ndarray, tilt: float = 0.0) -> np.ndarray:
    """Places on the skin as a camera shows them whose lens distorts by Brown's law, k1 = -0.05."""
    count = len(place_mm)
    skin = replace(
        SkinConfig().at_rest(),
        marker_mm=np.column_stack([place_mm, tilt * place_mm[:, 0]]),
        gradient=np.tile(np.eye(2), (count, 1, 1)),
    )
    return Optics(OpticsConfig()).project(skin).center_px


def rests_px(seed: int, tilt: float = 0.0) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0.0, NOISE_PX, (len(skin_mm()), 2))
    return imaged_px(skin_mm(), tilt) + noise


@pytest.mark.parametrize("tilt", [0.0, 0.05])
def test_displacements_at_the_rim_are_right_where_one_scale_is_wrong(tilt: float) -> None:
    lens = fit_lens(rests_px(1, tilt), GRID, SIZE, PITCH_MM)
    before, after = skin_mm(), skin_mm() + np.array([0.3, -0.2])
    moved_px = imaged_px(after, tilt) - imaged_px(before, tilt)
    moved_mm = lens.to_mm(imaged_px(after, tilt)) - lens.to_mm(imaged_px(before, tilt))
    off = np.abs(np.hypot(*moved_mm.T) / np.hypot(0.3, 0.2) - 1.0)
    one_scale = np.hypot(*moved_px.T) / np.median(np.hypot(*moved_px.T))
    assert np.abs(one_scale - 1.0).max() > 0.06
    assert off.max() < 0.012
    np.testing.assert_allclose(moved_mm, np.broadcast_to([0.3, -0.2], moved_mm.shape), atol=0.012)


@pytest.mark.parametrize(
    ("grid", "noise_px", "why"),
    [((2, 8), 0.05, "do not show a lens"), ((3, 3), 0.05, "do not show"), ((8, 8), 4.0, "rim")],
)
def test_what_the_grid_does_not_show_is_refused(
    grid: tuple[int, int], noise_px: float, why: str
) -> None:
    places = imaged_px(skin_mm(grid))
    noise = np.random.default_rng(2).normal(0.0, noise_px, places.shape)
    with pytest.raises(CalibrationError, match=why):
        fit_lens(places + noise, grid, SIZE, PITCH_MM)


def calibration() -> Calibration:
    return known(rests_px(3), 7.0, SIZE, GRID, px_per_mm=15.0)


def test_it_travels_with_the_calibration_and_the_tracks(tmp_path: Path) -> None:
    made = with_lens(calibration(), PITCH_MM)
    made.save(tmp_path / "calibration.json")
    read = Calibration.load(tmp_path / "calibration.json")
    np.testing.assert_array_equal(read.lens.homography, made.lens.homography)
    moved_px = imaged_px(skin_mm() + np.array([0.3, -0.2])) - imaged_px(skin_mm())
    tracks = tracks_of(read, moved_px)
    np.testing.assert_allclose(tracks.displacement_mm[0], [[0.3, -0.2]] * 64, atol=0.012)
    assert tracks.summary()["displacement_max_mm"] == pytest.approx(np.hypot(0.3, 0.2), rel=0.02)
    apart = compare_with_truth(tracks, tracks.t_us, read.reference_px[None])
    assert apart.summary()["error_mean_mm"] == pytest.approx(np.hypot(0.3, 0.2), rel=0.02)
    flat = tracks_of(replace(read, lens=None), moved_px)
    np.testing.assert_allclose(flat.displacement_mm[0], moved_px / 15.0, rtol=1e-5)


def tracks_of(sensor: Calibration, moved_px: np.ndarray) -> Tracks:
    place = (sensor.reference_px + moved_px)[None].astype(np.float32)
    return Tracks(
        t_us=np.array([0]),
        detected_px=place,
        position_px=place,
        displacement_px=moved_px[None].astype(np.float32),
        coasted=np.zeros((1, 64), bool),
        confidence=np.ones((1, 64), np.float32),
        reference_px=sensor.reference_px.astype(np.float32),
        meta=sensor.scale(),
    )


def test_a_grid_that_shows_none_keeps_its_calibration_and_says_why() -> None:
    uneven = calibration().reference_px + np.random.default_rng(4).normal(0.0, 4.0, (64, 2))
    found = with_lens(replace(calibration(), reference_px=uneven), PITCH_MM)
    assert found.lens is None
    assert "uncertain" in found.provenance["no_lens"]


@pytest.mark.parametrize(
    "damage",
    [
        {"homography": [[1, 0], [0, 1]]},
        {"homography": [[0, 0, 0]] * 3},
        {"radial": 1.5},
        {"radial": float("nan")},
        {"half_diagonal_px": 0},
        {"center_px": 3},
    ],
)
def test_a_damaged_lens_is_refused(damage: dict, tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    with_lens(calibration(), PITCH_MM).save(path)
    document = json.loads(path.read_text())
    document["lens"] |= damage
    path.write_text(json.dumps(document))
    with pytest.raises(CalibrationError):
        Calibration.load(path)
    tracks = tracks_of(calibration(), np.zeros((64, 2)))
    with pytest.raises(RecordingError, match="lens"):
        _ = replace(tracks, meta={**tracks.meta, "lens": document["lens"]}).displacement_mm


def test_the_local_scale_is_that_of_small_areas() -> None:
    lens, place = fit_lens(rests_px(1), GRID, SIZE, PITCH_MM), np.array([290.0, 40.0])
    scale = SkinScale(15.0, lens)
    corners = place + 2.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    x, y = scale.to_mm(corners).T
    area_mm2 = 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    assert scale.mm_per_px(place) == pytest.approx(np.sqrt(area_mm2 / 16.0), rel=1e-3)
    one = SkinScale(10.0)
    np.testing.assert_allclose(one.to_mm(np.array([[20.0, 5.0]])), [[2.0, 0.5]])
    assert one.mm_per_px(place) == pytest.approx(0.1)


def test_the_pitch_is_the_usual_distance_of_the_nearest_marker() -> None:
    x, y = np.meshgrid(np.arange(0.0, 120.0, 30.0), np.arange(0.0, 123.0, 41.0))
    assert marker_pitch_px(np.column_stack([x.ravel(), y.ravel()])) == 30.0
    line = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0], [200.0, 0.0]])
    assert marker_pitch_px(line) == 10.0, "a marker apart does not move it"
    with pytest.raises(ConfigError, match="1 marker has no pitch, at least 2"):
        marker_pitch_px(np.zeros((1, 2)))
