"""The law of indentation and what follows a touch with it."""

import dataclasses
import json

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.sim.gel.gel import Gel, GelConfig
from spikingtac.sim.gel.indenters import IndenterConfig, make_indenter
from spikingtac.sim.optics import Optics, OpticsConfig
from spikingtac.sim.scene.motions import IndenterMotion, MotionConfig, SegmentConfig
from spikingtac.sim.scene.scene import SkinConfig
from spikingtac.sim.states import MarkerImage, SkinState, image_radius_px
from spikingtac.touch.field.mlp import Mlp
from spikingtac.touch.indentation.field_features import FEATURES, FieldFeatures
from spikingtac.touch.indentation.indentation_law import IndentationLaw, fitted_law
from spikingtac.touch.indentation.monitor import (
    Indentation,
    IndentationMonitor,
    Peak,
    SteadyPeak,
)
from spikingtac.types import MarkerFrame
from stand_ins.painted_skin import PITCH_PX, PaintedSkin, square_calibration

CALIBRATION = square_calibration(4)
REST = CALIBRATION.reference_px
FRAME_US = 10_000


def pressed(depth_mm: float, distance_mm: float) -> tuple[SkinState, MarkerImage, MarkerImage]:
    """The twin's skin under a finger, its image, and that at rest."""
    skin, optics = SkinConfig(), Optics(OpticsConfig(distance_mm=distance_mm))
    press = SegmentConfig(kind="press", depth_mm=depth_mm, duration_s=0.2)
    motion = IndenterMotion(MotionConfig(x_mm=1.2, y_mm=1.2, height_mm=0.1, segments=(press,)))
    gel, state = Gel(GelConfig(), skin.rest_mm()), skin.at_rest()
    for share in (0.25, 0.5, 0.75, 1.0):
        pose = motion.pose(share * motion.duration_s)
        state = gel.step(0.05, make_indenter(IndenterConfig(kind="finger")), pose)
    return state, optics.project(state), optics.project(skin.at_rest())


@pytest.mark.parametrize(("depth_mm", "distance_mm"), [(1.2, 13.0), (2.0, 13.0), (2.0, 10.0)])
def test_a_finger_on_the_twin_is_as_deep_as_told(depth_mm: float, distance_mm: float):
    state, image, rest = pressed(depth_mm, distance_mm)
    features = FieldFeatures(rest.center_px, np.full(2, 159.5))
    growth = image_radius_px(image) / image_radius_px(rest) - 1.0
    seen = features.of(image.center_px - rest.center_px, growth, 2.4 / distance_mm)
    depth, sigma = (2.4 * value for value in fitted_law()(seen))
    true = state.marker_mm[:, 2]
    deepest = int(true.argmax())
    assert true[deepest] > 0.2
    assert depth[deepest] == pytest.approx(true[deepest], abs=0.12)
    assert np.sqrt(((depth - true) ** 2).mean()) < 0.05
    assert (np.abs(depth - true) < 2.0 * sigma).mean() > 0.85


def test_an_untouched_skin_is_not_pressed():
    features = FieldFeatures(REST, (np.array(CALIBRATION.size) - 1.0) / 2.0)
    depth, sigma = fitted_law()(features.of(np.zeros((16, 2)), np.zeros(16), 2.4 / 13.0))
    assert np.abs(2.4 * depth).max() < 0.05
    assert (sigma > 0.0).all()


def test_features_hold_neighbours_in_their_places():
    features = FieldFeatures(REST, (np.array(CALIBRATION.size) - 1.0) / 2.0)
    assert features.pitch_px == pytest.approx(PITCH_PX)
    growth = np.arange(16.0)
    seen = features.of(np.zeros((3, 16, 2)), np.tile(growth, (3, 1)), 0.2)
    assert seen.shape == (3, 16, FEATURES)
    block = seen[0, 5, 77:102].reshape(5, 5) / 10.0  # marker 5: row 1, column 1
    np.testing.assert_allclose(block[1:, 1:], growth.reshape(4, 4), atol=1e-9)
    assert not block[0].any()
    assert not block[:, 0].any()


def test_the_law_survives_its_file_and_refuses_others():
    law = fitted_law()
    copy = IndentationLaw.from_mapping(json.loads(json.dumps(law.to_mapping())))
    seen = np.random.default_rng(0).normal(size=(5, FEATURES))
    np.testing.assert_array_equal(copy(seen), law(seen))
    for broken in ({}, {"schema": 99}, law.to_mapping() | {"error_factor": -1.0}):
        with pytest.raises(ConfigError, match="no indentation law"):
            IndentationLaw.from_mapping(broken)
    with pytest.raises(ValueError, match="does not follow"):
        Mlp(law.network.weights[::-1], law.network.biases[::-1])
    with pytest.raises(ValueError, match="are needed"):
        IndentationLaw(Mlp(law.network.weights[:-1], law.network.biases[:-1]))


def frame(t_us: int, places: np.ndarray, coasted: bool = False) -> MarkerFrame:
    away = places - REST
    return MarkerFrame(t_us, places, places, away, np.full(16, coasted), np.ones(16))


def press_watched(
    distance_mm: float | None, coasted: bool = False
) -> tuple[Indentation, Peak | None]:
    """A press that spreads and grows the discs, and its last state and peak."""
    monitor, skin = IndentationMonitor(CALIBRATION, distance_mm), PaintedSkin(CALIBRATION, FRAME_US)
    away = (REST - REST.mean(axis=0)) / PITCH_PX
    bell = np.exp(-0.5 * (away**2).sum(axis=1))
    for step in [0] * 10 + list(range(1, 13)) + [12] * 8:
        places = REST + 0.15 * step * bell[:, None] * away
        monitor.absorb(skin.go(places, 0.01 * step * bell))
        monitor.update(frame(skin.t_us, places, coasted), places - REST, touching=step > 0)
    state = monitor.state
    assert state is not None
    return state, monitor.take_peak()


def test_without_the_cameras_distance_growth_is_told_and_no_depth():
    state, peak = press_watched(None)
    assert peak is not None
    assert state.indentation_mm is None
    assert state.indentation_sigma_mm is None
    assert peak.indentation_mm is None
    assert peak.growth == pytest.approx(state.growth.max(), abs=0.01)
    assert peak.growth == pytest.approx(0.12 * np.exp(-0.25), abs=0.015)
    assert abs(peak.growth - 0.12 * np.exp(-0.25)) < 2.0 * peak.growth_std


def test_with_it_the_depth_has_an_uncertainty():
    state, peak = press_watched(13.0)
    assert peak is not None
    assert state.indentation_mm is not None
    assert peak.indentation_mm is not None
    assert peak.indentation_std_mm is not None
    assert peak.indentation_mm == pytest.approx(state.indentation_mm.max(), abs=0.03)
    assert peak.indentation_mm > 0.1
    assert peak.indentation_std_mm > 0.0


@pytest.mark.parametrize(
    ("course", "most"),
    [
        ([], None),
        ([0.3], 0.3),
        ([0.1, 0.4], 0.1),
        ([0.1, 0.4, 0.2], 0.2),
        ([0.5] + 7 * [0.1], 0.1),
        ([0.1, 0.5, 0.5] + 5 * [0.1], 0.1),
        ([0.1, 0.2, 0.3, 0.3, 0.3, 0.3, 0.1, 0.0], 0.3),
    ],
)
def test_no_single_measurement_is_the_peak(course: list[float], most: float | None):
    peak = SteadyPeak()
    for value in course:
        peak.add(np.array([0.0, value]), np.array([0.5, 0.1 * value]))
    assert peak.most() == (None if most is None else (most, pytest.approx(0.1 * most)))


def test_a_touch_that_is_over_is_forgotten():
    monitor = IndentationMonitor(CALIBRATION, 13.0)
    monitor.update(frame(0, REST), np.zeros((16, 2)), touching=True)
    assert monitor.take_peak() is not None
    assert monitor.take_peak() is None
    monitor.reset()
    assert monitor.state is None


def test_markers_that_nobody_sees_make_no_peak():
    _, peak = press_watched(13.0, coasted=True)
    assert peak is None


def test_scale_and_distance_are_needed():
    with pytest.raises(ConfigError, match="-2"):
        IndentationMonitor(CALIBRATION, -2.0)
    with pytest.raises(ConfigError, match="--pitch-mm"):
        IndentationMonitor(dataclasses.replace(CALIBRATION, px_per_mm=None), 13.0)
