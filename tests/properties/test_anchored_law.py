"""The anchored law: what it promises, and what it costs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikingtac.errors import ConfigError
from spikingtac.markers.anchored_law import AnchoredLaw, AnchoredLawConfig, ReZero, ReZeroConfig

REST = np.array([[100.0, 60.0]])
distances_px = np.linspace(0.0, 6.0, 60_001)
LAWS = [(0.7, 2.0, 4.0), (0.3, 1.0, 3.0), (0.3, 0.75, 2.0), (0.05, 0.0, 1.0), (0.9, 1.0, 8.0)]


def config(values: tuple[float, float, float]) -> AnchoredLawConfig:
    gamma, delta1_px, delta2_px = values
    return AnchoredLawConfig(gamma=gamma, delta1_px=delta1_px, delta2_px=delta2_px)


def mapped(point: np.ndarray, law: AnchoredLaw | None = None) -> np.ndarray:
    return (law or AnchoredLaw()).update(REST + point, REST)[0] - REST[0]


points = st.tuples(st.floats(-12.0, 12.0), st.floats(-12.0, 12.0)).map(np.array)


@pytest.mark.parametrize("values", LAWS)
def test_shape_of_the_map(values: tuple[float, float, float]) -> None:
    law = config(values)
    radius = law.radius_px(distances_px)
    slope = np.diff(radius) / np.diff(distances_px)
    near, far = distances_px <= law.delta1_px, distances_px >= law.delta2_px
    np.testing.assert_allclose(radius[near], law.gamma * distances_px[near], atol=1e-12)
    np.testing.assert_array_equal(radius[far], distances_px[far])
    assert slope.min() > 0.0, "it never folds"
    assert np.abs(np.diff(slope)).max() < 0.01, "its slope is continuous"
    assert slope.max() == pytest.approx(law.steepest_slope, abs=1e-3)
    assert np.abs(radius - distances_px).max() == pytest.approx(
        law.worst_falsification_px, abs=1e-4
    )
    assert law.steepest_slope >= law.chord_slope


@pytest.mark.parametrize(
    ("values", "slope", "falsification_px"),
    [((0.7, 2.0, 4.0), 1.53, 0.63), ((0.3, 1.0, 3.0), 1.73, 0.81), ((0.3, 0.75, 2.0), 1.83, 0.59)],
)
def test_tabulated_costs(
    values: tuple[float, float, float], slope: float, falsification_px: float
) -> None:
    assert config(values).steepest_slope == pytest.approx(slope, abs=0.005)
    assert config(values).worst_falsification_px == pytest.approx(falsification_px, abs=0.005)


def test_the_default_keeps_its_bounds() -> None:
    assert config((0.3, 0.75, 2.0)) == AnchoredLawConfig()
    assert AnchoredLawConfig().worst_falsification_px <= 0.6
    assert AnchoredLawConfig().steepest_slope <= 1.9
    residues_px = AnchoredLawConfig().radius_px(np.array([0.45, 0.95, 1.45]))
    assert residues_px.tolist() == pytest.approx([0.14, 0.36, 1.14], abs=0.006)


@given(point=points)
def test_the_map_is_radial_and_the_identity_far_out(point: np.ndarray) -> None:
    out = mapped(point)
    assert abs(out[0] * point[1] - out[1] * point[0]) < 1e-9
    assert out @ point >= 0.0
    if np.hypot(*point) >= 2.0:
        np.testing.assert_allclose(out, point, atol=1e-9)
    if np.hypot(*point) <= 0.75:
        np.testing.assert_allclose(out, 0.3 * point, atol=1e-9)


@settings(deadline=None)
@given(path=st.lists(points, min_size=1, max_size=20), last=points)
def test_the_output_depends_on_the_present_detection_alone(
    path: list[np.ndarray], last: np.ndarray
) -> None:
    law = AnchoredLaw()
    for point in path:
        mapped(point, law)
    np.testing.assert_allclose(mapped(last, law), mapped(last), atol=1e-9)


@settings(deadline=None)
@given(one=points, two=points)
def test_jitter_is_amplified_by_the_steepest_slope_at_most(
    one: np.ndarray, two: np.ndarray
) -> None:
    apart = np.hypot(*(mapped(one) - mapped(two)))
    assert apart <= AnchoredLawConfig().steepest_slope * np.hypot(*(one - two)) + 1e-9


def test_a_gain_of_one_is_the_identity() -> None:
    identity = AnchoredLawConfig(gamma=1.0)
    np.testing.assert_allclose(identity.radius_px(distances_px), distances_px, atol=1e-12)
    assert identity.steepest_slope == 1.0
    assert identity.worst_falsification_px == 0.0


@pytest.mark.parametrize(
    "values", [(0.0, 1.0, 2.0), (1.2, 1.0, 2.0), (0.3, 2.0, 2.0), (0.3, -1, 2)]
)
def test_unfit_settings_are_refused(values: tuple[float, float, float]) -> None:
    with pytest.raises(ConfigError):
        config(values)


def settled(law: ReZero, point: np.ndarray, seconds: float, in_contact: bool) -> np.ndarray:
    start_us = 10_000_000
    law.observe(start_us, in_contact=True)
    law.observe(start_us + round(seconds * 1e6), in_contact)
    return law.update(REST + point, REST)[0] - REST[0]


def test_a_residue_fades_while_nothing_touches() -> None:
    residue = np.array([0.9, -0.3])
    faded = settled(ReZero(), residue, 2.0, in_contact=False)
    expected = mapped(residue * np.exp(-1.0))
    np.testing.assert_allclose(faded, expected, atol=1e-9)
    assert np.hypot(*settled(ReZero(), residue, 60.0, in_contact=False)) < 1e-9


def test_the_zero_is_frozen_in_contact_and_until_told() -> None:
    residue = np.array([0.9, -0.3])
    np.testing.assert_array_equal(settled(ReZero(), residue, 60.0, True), mapped(residue))
    np.testing.assert_array_equal(
        ReZero().update(REST + residue, REST)[0] - REST[0], mapped(residue)
    )


def test_the_zero_does_not_depend_on_how_often_one_looks() -> None:
    residue = np.array([1.1, 0.4])
    often = ReZero()
    often.observe(0, in_contact=False)
    for t_us in range(1_000, 3_000_001, 1_000):
        often.observe(t_us, in_contact=False)
        out = often.update(REST + residue, REST)[0] - REST[0]
    np.testing.assert_allclose(out, settled(ReZero(), residue, 3.0, False), atol=1e-6)


@given(point=points)
def test_the_zero_stays_within_its_reach(point: np.ndarray) -> None:
    law = ReZero(ReZeroConfig(reach_px=1.5))
    settled(law, point, 1e3, in_contact=False)
    assert law.zero_px is not None
    assert np.hypot(*law.zero_px[0]) <= 1.5 + 1e-9


def test_a_light_static_press_called_no_contact_is_lost() -> None:
    """The indistinguishable case: it looks like residue, and documentation says so."""
    press = np.array([1.2, 0.0])
    assert np.hypot(*settled(ReZero(), press, 20.0, in_contact=False)) < 0.01
    assert np.hypot(*settled(ReZero(), press, 20.0, in_contact=True)) > 0.5


def test_a_reset_puts_the_zero_back() -> None:
    law = ReZero()
    settled(law, np.array([1.0, 0.0]), 10.0, in_contact=False)
    law.reset()
    assert law.zero_px is None
    np.testing.assert_array_equal(
        law.update(REST + np.array([1.0, 0.0]), REST)[0] - REST[0], mapped(np.array([1.0, 0.0]))
    )


def test_unfit_rezero_settings_are_refused() -> None:
    with pytest.raises(ConfigError, match="time_constant_us"):
        ReZeroConfig(time_constant_us=0)
    with pytest.raises(ConfigError, match="reach_px"):
        ReZeroConfig(reach_px=-0.1)
