"""What the output laws do, fact by fact: the published one, and the anchored one."""

from itertools import pairwise
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikingtac.errors import ConfigError
from spikingtac.markers.laws import AnchoredLaw, OutputLaw, PaperLaw, PaperLawConfig, anchored_px
from spikingtac.markers.registry import TrackingConfig, make_law
from spikingtac.types import LawName

REST = np.array([[100.0, 60.0]])


def line(start: tuple[float, float], end: tuple[float, float], samples: int) -> np.ndarray:
    share = np.arange(1, samples + 1)[:, None] / samples
    return np.array(start) + share * (np.array(end) - np.array(start))


def run(law: OutputLaw, path: np.ndarray) -> np.ndarray:
    return np.array([law.update(REST + point, REST)[0] - REST[0] for point in path])


def closed(points: list[tuple[float, float]], samples: int) -> np.ndarray:
    """Return a way from point to point and back to the first, of so many samples a leg."""
    legs = pairwise([*points, points[0]])
    return np.concatenate([line(one, two, samples) for one, two in legs])


def corner_loop() -> np.ndarray:
    """Leave along +x by 10 px, round the corner outside of the window, return along +y."""
    return closed([(0, 0), (10, 0), (10, 10), (0, 10)], 1_000)


@pytest.mark.parametrize("loops", [1, 2, 5])
def test_a_loop_round_the_corner_shifts_the_zero_each_time(loops: int) -> None:
    end = run(PaperLaw(), np.concatenate([corner_loop()] * loops))[-1]
    assert np.hypot(*end) == pytest.approx(loops * 0.3 * 4.0 * np.sqrt(2.0), abs=0.01 * loops)
    assert end[0] < 0.0 < end[1] or end[1] < 0.0 < end[0]


@pytest.mark.parametrize(("samples", "offset_px"), [(1, 3.0), (2, 1.5), (5, 0.6)])
def test_the_bias_of_a_straight_trip_depends_on_the_rate(samples: int, offset_px: float) -> None:
    path = closed([(0, 0), (10, 0)], samples)
    assert run(PaperLaw(), path)[-1].tolist() == pytest.approx([offset_px, 0.0])


def test_a_fine_grained_residue_is_scaled_not_removed() -> None:
    trip = [line((0, 0), (12, 0), 12_000), line((12, 0), (2, 0), 10_000)]
    assert run(PaperLaw(), np.concatenate(trip))[-1, 0] == pytest.approx(1.4, abs=0.002)


@settings(max_examples=50)
@given(
    radius_and_angle=st.lists(
        st.tuples(st.floats(0.0, 3.9), st.floats(0.0, 6.28)), min_size=2, max_size=6
    )
)
def test_loops_wholly_inside_the_window_leave_nothing(
    radius_and_angle: list[tuple[float, float]],
) -> None:
    points = [(r * np.cos(a), r * np.sin(a)) for r, a in radius_and_angle]
    law = PaperLaw()
    start = run(law, np.array([points[0]]))[-1]
    np.testing.assert_allclose(run(law, closed(points, 7))[-1], start, atol=1e-9)


def test_the_window_belongs_to_the_outside() -> None:
    assert run(PaperLaw(), np.array([[4.0, 0.0]]))[-1, 0] == pytest.approx(4.0)
    assert run(PaperLaw(), np.array([[3.999, 0.0]]))[-1, 0] == pytest.approx(0.7 * 3.999)


def test_every_named_law_is_built_and_no_other() -> None:
    laws = {type(make_law(TrackingConfig(hysteresis=name))) for name in get_args(LawName)}
    assert laws == {OutputLaw, PaperLaw, AnchoredLaw}
    with pytest.raises(ConfigError, match="anchored"):
        make_law(TrackingConfig(hysteresis="anchor"))


@pytest.mark.parametrize("values", [{"delta_px": -1.0}, {"gamma": -0.1}, {"gamma": 1.1}])
def test_unfit_settings_are_refused(values: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(values))):
        PaperLawConfig(**values)


def mapped(point: np.ndarray, law: AnchoredLaw | None = None) -> np.ndarray:
    return (law or AnchoredLaw()).update(REST + point, REST)[0] - REST[0]


points = st.tuples(st.floats(-12.0, 12.0), st.floats(-12.0, 12.0)).map(np.array)


def test_shape_and_costs_of_the_anchored_map() -> None:
    distances_px = np.linspace(0.0, 6.0, 60_001)
    radius = anchored_px(distances_px)
    slope = np.diff(radius) / np.diff(distances_px)
    assert slope.min() > 0.0, "it never folds"
    assert np.abs(np.diff(slope)).max() < 0.01, "its slope is continuous"
    assert slope.max() == pytest.approx(1.83, abs=0.005)
    assert np.abs(radius - distances_px).max() == pytest.approx(0.59, abs=0.005)
    residues_px = anchored_px(np.array([0.45, 0.95, 1.45]))
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


@given(path=st.lists(points, min_size=1, max_size=20), last=points)
def test_the_output_depends_on_the_present_detection_alone(
    path: list[np.ndarray], last: np.ndarray
) -> None:
    law = AnchoredLaw()
    for point in path:
        mapped(point, law)
    np.testing.assert_allclose(mapped(last, law), mapped(last), atol=1e-9)
