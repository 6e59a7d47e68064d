"""Each marker's own appearance, and what stands in where it is unknown."""

from dataclasses import replace

import numpy as np
import pytest

from spikingtac.calibration.disc_profile import Discs, nearest_marker
from spikingtac.markers.graded.appearance import needs_dead_bands, painted_map, steps_of
from spikingtac.state_map.graded import STEP_DEFAULT
from stand_ins.known import known

PLAIN = known(np.array([[20.0, 20.0], [60.0, 20.0]]), np.array([6.0, 7.0]), (80, 40), (1, 2))


def test_a_markers_own_values_come_before_the_sensors() -> None:
    calibration = replace(
        PLAIN, edge_px=0.7, step_off=0.2, marker_step_off=np.array([0.3, 0.4]), step_on=0.11
    )
    np.testing.assert_array_equal(Discs.of(calibration).edge_px, [0.7, 0.7])
    np.testing.assert_array_equal(steps_of(calibration), [[0.11, 0.11], [0.3, 0.4]])


def test_pixels_without_a_step_of_their_own_take_their_markers() -> None:
    own = np.zeros((40, 80), np.float32)
    own[20, 20] = 0.05
    calibration = replace(PLAIN, marker_step_on=np.array([0.1, 0.2]), step_on_map=own)
    steps = painted_map(calibration).pixels
    assert steps["on"][20, [20, 21, 61]] == pytest.approx([0.05, 0.1, 0.2])
    assert steps["off"][20, 21] == pytest.approx(-STEP_DEFAULT)


@pytest.mark.parametrize("whole", [True, False])
def test_the_nearest_marker_owns_a_pixel(whole: bool) -> None:
    rng, size = np.random.default_rng(4), (150, 70)
    reference_px = rng.random((40, 2)) * size
    reference_px = np.round(reference_px) if whole else reference_px
    rows, columns = np.mgrid[0 : size[1], 0 : size[0]]
    away2 = np.array([(columns - x) ** 2 + (rows - y) ** 2 for x, y in reference_px])
    own2 = np.take_along_axis(away2, nearest_marker(reference_px, size)[np.newaxis], axis=0)
    np.testing.assert_allclose(own2[0], away2.min(axis=0))


def test_large_steps_and_wide_edges_need_dead_bands_unless_pixels_recover() -> None:
    blurred = {"step_on": 0.15, "step_off": 0.31, "edge_px": 1.3}
    needed = {"step_on": 0.31, "step_off": 0.2}, {"edge_px": 1.3}, blurred
    assert all(needs_dead_bands(replace(PLAIN, **own)) for own in needed)
    others = {}, {"step_off": 0.29}, {"edge_px": 1.1}, blurred | {"recovery_s": 0.2}
    assert not any(needs_dead_bands(replace(PLAIN, **own)) for own in others)
