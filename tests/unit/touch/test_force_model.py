"""Force models: learned from made-up presses, kept in a file, applied frame by frame."""

from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import ConfigError, RecordingError
from spikingtac.pipeline.track import ForceLimit
from spikingtac.touch.force.fit import fit_force, retarget, score_force
from spikingtac.touch.force.model import ForceModel, Wrench, load_force
from spikingtac.touch.network import Network, with_record
from spikingtac.touch.series import WrenchSeries, labelled
from spikingtac.types import EventPacket
from stand_ins.live import MovedBy

X, Y = np.meshgrid(np.arange(6.0), np.arange(5.0))
REFERENCE = np.column_stack([X.ravel(), Y.ravel()])
NOISE_MM = 0.005


def press(center: np.ndarray, depth: float, drag: np.ndarray) -> np.ndarray:
    """Return how markers spread away from a press, and are dragged with it."""
    away = REFERENCE - center
    return (0.5 * depth * away + drag) * np.exp(-0.5 * (away**2).sum(axis=1, keepdims=True) / 4.0)


PRESS = press(np.array([2.5, 2.0]), 1.0, np.zeros(2))


def series(seed: int, *, rest_mm: float = 0.0) -> WrenchSeries:
    """Presses that spread the markers and drag them; shear is linear, pressing a power law."""
    rng = np.random.default_rng(seed)
    frames = []
    for _ in range(60):
        depth, drag = rng.uniform(0.2, 1.0), rng.uniform(-0.5, 0.5, 2)
        center = rng.uniform([1.5, 1.5], [3.5, 2.5])
        for share in np.r_[np.zeros(3), np.linspace(0, 1, 10)]:
            force = [*(4.0 * share * drag), -3.0 * (share * depth) ** 1.5]
            frames.append((share * press(center, depth, drag), force))
    moved, wrench = map(np.array, zip(*frames, strict=True))
    moved = moved + rest_mm + rng.normal(0.0, NOISE_MM, moved.shape)
    t_us = np.arange(len(frames), dtype=np.int64) * 20_000
    return WrenchSeries(t_us, REFERENCE, moved, wrench, "mm", f"series {seed}")


@pytest.fixture(scope="module")
def model() -> ForceModel:
    return fit_force([series(1), series(2, rest_mm=0.01), series(21)])


def test_a_series_that_was_not_learned_is_told_well(model: ForceModel) -> None:
    scores = {score.component: score for score in score_force(model, series(3))}
    assert list(scores) == ["fx", "fy", "fz"]
    assert min(score.r2 for score in scores.values()) > 0.95
    assert all(0.8 < score.coverage90 < 0.99 for score in scores.values())


def test_a_mirrored_contact_is_told_mirrored() -> None:
    """On one half of the skin alone contacts are learned, on the other they are told."""
    both = [series(1), series(2)]
    left = [one.part(one.wrench[:, 0] <= 0.0) for one in both]  # drags to the right make fx > 0
    test = series(3)
    fx = score_force(fit_force(left), test.part(test.wrench[:, 0] > 0.0))[0]
    assert fx.mae < 0.12


def test_a_model_serves_another_sensor_after_a_few_presses(
    model: ForceModel, tmp_path: Path
) -> None:
    """Twice as stiff, in px, with fewer markers at other places."""
    axes = np.meshgrid(np.linspace(0.0, 5.0, 5), np.linspace(0.0, 4.0, 5))
    places = np.stack(axes, axis=-1).reshape(-1, 2)
    near = np.exp(-4.0 * ((places[:, None] - REFERENCE) ** 2).sum(axis=2))
    near /= near.sum(axis=1, keepdims=True)

    def other(seed: int, frames: int) -> WrenchSeries:
        one = series(seed).part(np.arange(frames))
        moved = 24.0 * np.einsum("km,nmd->nkd", near, one.displacement)
        return WrenchSeries(one.t_us, 24.0 * places, moved, 2.0 * one.wrench, "px", f"other {seed}")

    retarget(model, [other(31, 130)]).save(tmp_path / "other.onnx")  # ten presses
    scores = score_force(load_force(tmp_path / "other.onnx"), other(32, 700))
    assert min(score.r2 for score in scores) > 0.9
    assert min(score.coverage90 for score in scores) > 0.7
    few = score_force(retarget(model, [other(31, 40)]), other(32, 700))  # three presses
    assert min(score.r2 for score in few) > 0.8
    assert min(score.coverage90 for score in few) > 0.7
    with pytest.raises(ConfigError, match="at least 20"):
        retarget(model, [other(31, 10)])


def test_rest_is_no_force_however_far_it_moved(model: ForceModel) -> None:
    rng, estimator, inside = np.random.default_rng(0), model.estimator(), []
    for k in range(700):
        moved = 0.02 * min(k / 100, 1.0) + rng.normal(0.0, NOISE_MM, REFERENCE.shape)
        wrench = estimator.update(k * 20_000, moved)
        if k > 600:  # the zero, a mean over 3 s, has caught up
            inside.append(np.abs(wrench.force_n) <= wrench.half_width[:3])
    assert np.mean(inside) >= 0.9
    with pytest.raises(ConfigError, match="not finite; leave such frames out"):
        estimator.update(14_500_000, np.full(REFERENCE.shape, np.nan))  # and it is forgotten
    far = 0.3 * np.ones(REFERENCE.shape)
    estimator.update(15_000_000, far)
    estimator.tare()
    wrench = estimator.update(15_020_000, far)
    assert np.abs(wrench.force_n).max() < 0.02
    np.testing.assert_allclose(wrench.force_sigma_n, wrench.half_width[:3] / 1.645)
    told = Wrench(0, np.array([3.0, 0.0, -4.0]), np.array([0.0, 1.0, 1.0]))
    assert (told.exceeds(4.2), told.exceeds(4.3)) == (True, False)  # 3 and 3 N surely
    estimator.reset()
    assert np.abs(estimator.update(0, far).force_n).max() > 0.3


@pytest.mark.parametrize("rate_hz", [50, 1_000, 10_000])
def test_a_slow_press_is_told_alike_however_fast_the_frames_come(
    model: ForceModel, rate_hz: int
) -> None:
    press = 0.8 * PRESS
    estimator, told = model.estimator(), None
    for k in range(2 * rate_hz):
        told = estimator.update(k * 1_000_000 // rate_hz, min(k / rate_hz, 1.0) * press)
    assert told.force_n[2] == pytest.approx(-3.0 * 0.8**1.5, abs=0.5)


def test_an_arm_is_stopped_where_the_force_surely_exceeds_its_limit(model: ForceModel) -> None:
    """On a press of 3 N * depth ** 1.5 that grows for a second."""
    tracker = MovedBy(REFERENCE, lambda t_us: max(t_us / 1e6 - 0.2, 0.0) * PRESS)
    limit = ForceLimit(tracker, model.estimator(), 1.5)
    windows = [EventPacket.empty(k * 1_000, (k + 1) * 1_000, (9, 9)) for k in range(1_200)]
    (told,) = [contact for window in windows if (contact := limit.update(window))]
    true_n = 3.0 * (told.t_us / 1e6 - 0.2) ** 1.5
    assert 1.5 < true_n < 2.5
    assert told.count > told.threshold == 1.5
    assert limit.in_contact
    with pytest.raises(ConfigError, match="must be positive"):
        ForceLimit(tracker, model.estimator(), 0.0)


def test_a_model_survives_its_file(model: ForceModel, tmp_path: Path) -> None:
    model.save(tmp_path / "force.onnx")
    again = load_force(tmp_path / "force.onnx")
    assert again.record == model.record
    one = series(5)
    for before, after in zip(model.estimate(one), again.estimate(one), strict=True):
        np.testing.assert_array_equal(before, after)


def test_other_and_damaged_files_are_refused(model: ForceModel, tmp_path: Path) -> None:
    path = tmp_path / "force.onnx"
    content = model.network.content
    record = {**model.record, "interval": [[1.0, "x", 0.0]] * 3}
    for bad in (b"", b"{}", content[:-40], with_record(content, {}), with_record(content, record)):
        path.write_bytes(bad)
        with pytest.raises(ConfigError, match="force fit"):
            load_force(path)
    with pytest.raises(ConfigError, match="schema 3"):
        ForceModel(Network(with_record(content, {**model.record, "schema": 3}), "old"))
    with pytest.raises(ConfigError, match="force fit"):
        load_force(tmp_path / "none.onnx")


def test_another_sensor_is_refused(model: ForceModel) -> None:
    one = series(8)
    fewer = WrenchSeries(one.t_us, REFERENCE[:9], one.displacement[:, :9], one.wrench, "mm", "few")
    pixels = WrenchSeries(one.t_us, REFERENCE, one.displacement, one.wrench, "px", "pixels")
    empty = fewer.part(one.t_us < 0)
    for bad, told in ((fewer, "few has 9 markers in mm"), (pixels, "in px"), (empty, "no frame")):
        with pytest.raises(ConfigError, match=told):
            model.estimate(bad)
    for other in (1.2 * REFERENCE, REFERENCE[:, ::-1], REFERENCE[::-1]):
        with pytest.raises(ConfigError, match="markers that lie"):
            model.require(np.ascontiguousarray(other), "mm")
    model.require(REFERENCE + 3.0, "mm")  # elsewhere in the image, the same layout
    for shape in ((29, 2), (30, 3), (60,)):
        with pytest.raises(ConfigError, match=r"30, 2"):
            model.estimator().update(0, np.zeros(shape))


def test_too_little_makes_no_model() -> None:
    one, at = series(9), REFERENCE
    rows = (at, one.wrench[:, :0]), (at, 0.0 * one.wrench), (at[::-1], one.wrench)
    odd = [WrenchSeries(one.t_us, at, one.displacement, wrench, "mm", "it") for at, wrench in rows]
    every = *odd, one, one.part(one.t_us < 0), one.part(one.t_us < 1_000_000)
    told = *2 * ["holds no wrench"], "markers that lie", "twice", "in its 0", "50 labelled"
    for other, why in zip(every, told, strict=True):
        with pytest.raises(ConfigError, match=why):
            fit_force([other] if why.startswith("50") else [one, other])


def test_a_broken_series_is_refused() -> None:
    one = series(1)
    for shape in ((5, 3), (len(one.t_us), 7)):
        with pytest.raises(RecordingError, match="the wrench is"):
            WrenchSeries(one.t_us, REFERENCE, one.displacement, np.zeros(shape), "mm")
    with pytest.raises(RecordingError, match="coordinates"):
        WrenchSeries(one.t_us, REFERENCE[:, :1], one.displacement, one.wrench, "mm")
    broken = one.displacement.copy()
    broken[3, 2, 1] = np.nan
    with pytest.raises(RecordingError, match="not finite"):
        WrenchSeries(one.t_us, REFERENCE, broken, one.wrench, "mm")


CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])


def pressing(t_s: np.ndarray) -> np.ndarray:
    """Three presses at odd moments."""
    moments = ((1.0, 0.5), (2.7, 0.9), (5.1, 0.3))
    return sum((np.exp(-(((t_s - at) / width) ** 2)) for at, width in moments), 0.0 * t_s)


def watched() -> WrenchSeries:
    t_us = np.arange(0, 7_000_000, 10_000, dtype=np.int64)
    moved = np.ones((len(t_us), 4, 2)) * 0.4 * pressing(t_us / 1e6)[:, None, None]
    return WrenchSeries(t_us, CORNERS, moved, np.empty((len(t_us), 0)), "mm", "watched")


def test_a_force_sensor_on_another_clock_is_aligned(tmp_path: Path) -> None:
    path, t_s = tmp_path / "force.csv", np.arange(-0.5, 7.5, 0.002)
    rows = np.column_stack([t_s + 1234.5678, 0 * t_s, 0 * t_s + 0.1, -5 * pressing(t_s)])
    np.savetxt(path, rows, "%.6f", ",", header="t_s,Fx,Fy,Fz", comments="")
    series = labelled(watched(), path)
    truth = -5 * pressing(series.t_us / 1e6)
    assert len(series.t_us) == len(watched().t_us)
    np.testing.assert_allclose(series.wrench[:, 2], truth, atol=0.05)


def test_forces_of_another_recording_are_refused(tmp_path: Path) -> None:
    path, values = tmp_path / "force.csv", np.random.default_rng(0).normal(size=500)
    rows = np.column_stack([10_000 * np.arange(500), values, 0 * values, 0 * values])
    np.savetxt(path, rows, "%.9g", ",", header="t_us,fx,fy,fz", comments="")
    with pytest.raises(RecordingError, match="same recording"):
        labelled(watched(), path)
    rows[-1, 0] = 1e15  # years later: a moment is drawn for every 5 ms
    np.savetxt(path, rows, "%.16g", ",", header="t_us,fx,fy,fz", comments="")
    with pytest.raises(RecordingError, match="more than a day; is a time wrong"):
        labelled(watched(), path)


def test_the_truth_of_the_twin_needs_no_alignment(tmp_path: Path) -> None:
    t_us = np.array([1_000_000, 2_000_000, 3_000_000], np.int64)
    force = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 2.0], [0.0, 1.0, 3.0]])
    np.savez(tmp_path / "truth.npz", contact_t_us=t_us, force_n=force, torque_n_mm=1000 * force)
    series = labelled(watched(), tmp_path)
    assert series.t_us[0] == 1_000_000
    assert series.t_us[-1] == 3_000_000
    middle = np.searchsorted(series.t_us, 1_500_000)
    np.testing.assert_allclose(series.wrench[middle], [0.5, 0.0, 1.5] * 2)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "t_us,fx\n1,2\n",
        "t_us,fx,fy,fz\n1,a,2,3\n",
        "t_us,fx,fy,fz\n",
        "t_us,fx,fy,fz\n1,0,0,1\n2,0,nan,1\n",
        "t_us,fx,fy,fz,mz\n1,0,0,1,0\n",
    ],
)
def test_files_without_forces_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "force.csv"
    path.write_text(text)
    with pytest.raises(RecordingError, match=r"force\.csv"):
        labelled(watched(), path)
    with pytest.raises(RecordingError, match="forces"):
        labelled(watched(), tmp_path)
