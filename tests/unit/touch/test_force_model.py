"""Force laws on a skin whose forces are known."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spikingtac.errors import ConfigError, RecordingError
from spikingtac.touch.force import fit
from spikingtac.touch.force.creep_memory import CreepConfig
from spikingtac.touch.force.files.model_file import load_force, save_force
from spikingtac.touch.force.fit import CHOICES, NORMAL, fit_force
from spikingtac.touch.force.model import ForceModel
from spikingtac.touch.force.neighbourhood import likeness, unlike_ones
from spikingtac.touch.force.rest_zero import RestZeroConfig
from spikingtac.touch.force.score import score_force
from spikingtac.touch.force.wrench_series import WrenchSeries

X, Y = np.meshgrid(np.arange(6.0), np.arange(5.0))
REFERENCE = np.column_stack([X.ravel(), Y.ravel()])
NOISE_MM = 0.005


def series(seed: int, *, largest: float = 1.0, rest_mm: float = 0.0) -> WrenchSeries:
    """Presses that spread the markers and drag them; shear is linear, pressing a power law."""
    rng = np.random.default_rng(seed)
    frames = []
    for _ in range(60):
        depth, drag = largest * rng.uniform(0.2, 1.0), rng.uniform(-0.5, 0.5, 2)
        center = rng.uniform([1.5, 1.5], [3.5, 2.5])
        for share in np.r_[np.zeros(3), np.linspace(0, 1, 10)]:
            away = REFERENCE - center
            near = np.exp(-0.5 * (away**2).sum(axis=1, keepdims=True) / 4.0)
            moved = share * (0.5 * depth * away * near + drag * near)
            force = [*(4.0 * share * drag), -3.0 * (share * depth) ** 1.5]
            frames.append((moved, force))
    moved = np.array([frame[0] for frame in frames]) + rest_mm
    moved = moved + rng.normal(0.0, NOISE_MM, moved.shape)
    t_us = np.arange(len(frames), dtype=np.int64) * 20_000
    return WrenchSeries(
        t_us, REFERENCE, moved, np.array([f[1] for f in frames]), "mm", f"series {seed}"
    )


@pytest.fixture(scope="module")
def model() -> ForceModel:
    return fit_force([series(1), series(2, rest_mm=0.01), series(21)])


def test_a_series_that_was_not_learned_is_told_well(model: ForceModel) -> None:
    scores = {score.component: score for score in score_force(model, series(3))}
    assert list(scores) == ["fx", "fy", "fz"]
    assert min(score.r2 for score in scores.values()) > 0.95
    for score in scores.values():
        assert score.coverage90 > 0.8


def test_a_zero_that_moved_is_learned_at_rest(model: ForceModel) -> None:
    still = [score.mae for score in score_force(model, series(4))]
    moved = [score.mae for score in score_force(model, series(4, rest_mm=0.015))]
    unaware = dataclasses.replace(model, zero=RestZeroConfig(radius_share=0.0))
    lost = [score.mae for score in score_force(unaware, series(4, rest_mm=0.015))]
    gain = (np.array(lost[:2]) - still[:2]) / (np.array(moved[:2]) - still[:2])
    assert (gain > 1.5).all()


def test_of_two_normal_laws_that_are_alike_the_first_is_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    taught, between = [series(41), series(42)], {}
    for other in ("fx", "fy"):
        monkeypatch.setitem(CHOICES, other, CHOICES[other][:1])
    for choices in (NORMAL, NORMAL[:1], NORMAL[1:]):
        monkeypatch.setitem(CHOICES, "fz", choices)
        model = fit_force(taught)
        between[choices] = model.about["r2_between_series"]["fz"], model.laws[2].name
    (first, name), (other, _) = between[NORMAL[:1]], between[NORMAL[1:]]
    assert other == pytest.approx(first, abs=0.002)
    assert between[NORMAL] == (first, name)


def test_rest_is_quiet(model: ForceModel) -> None:
    estimator = model.estimator()
    wrench = estimator.update(0, np.zeros((len(REFERENCE), 2)))
    np.testing.assert_allclose(wrench.force_n, 0.0, atol=0.1)
    assert not wrench.extrapolated


@pytest.mark.parametrize("rate_hz", [18, 50, 1_000, 10_000])
def test_a_slow_press_is_told_alike_however_fast_the_frames_come(
    model: ForceModel, rate_hz: int
) -> None:
    rng, estimator = np.random.default_rng(9), model.estimator()
    away = REFERENCE - [2.5, 2.0]
    pressed = 0.4 * away * np.exp(-0.5 * (away**2).sum(axis=1, keepdims=True) / 4.0)
    told = []
    for number in range(2 * rate_hz):  # a second of rest, then a second of growing load
        share = max(number / rate_hz - 1.0, 0.0)
        moved = share * pressed + rng.normal(0.0, NOISE_MM, pressed.shape)
        told.append(estimator.update(number * 1_000_000 // rate_hz, moved).force_n[2])
    last = told[-max(rate_hz // 50, 1) :]
    expected = -3.0 * 0.8**1.5
    assert np.mean(last) == pytest.approx(expected, abs=0.25)


def test_the_stream_equals_the_batch(model: ForceModel) -> None:
    one = series(5)
    values, widths, distances = model.estimate(one)
    estimator = model.estimator()
    for index in range(80):
        wrench = estimator.update(int(one.t_us[index]), one.displacement[index])
        np.testing.assert_allclose(wrench.values, values[index], atol=1e-9)
        np.testing.assert_allclose(wrench.half_width, widths[index], atol=1e-9)
        assert wrench.distance == pytest.approx(distances[index])


def test_beyond_what_was_learned_the_interval_widens_and_a_flag_says_so(
    model: ForceModel,
) -> None:
    inside, beyond = model.estimator(), model.estimator()
    field = series(6).displacement[12]
    known = inside.update(0, field)
    unknown = beyond.update(0, 4.0 * field)
    assert not known.extrapolated
    assert unknown.extrapolated
    assert (unknown.half_width > 2.0 * known.half_width).all()


def test_a_model_survives_its_file(model: ForceModel, tmp_path: Path) -> None:
    path = tmp_path / "force.json"
    save_force(model, path)
    assert json.loads(path.read_text())["unit"] == "mm"
    again = load_force(path)
    one = series(7)
    for ours, theirs in zip(model.estimate(one), again.estimate(one), strict=True):
        np.testing.assert_allclose(theirs, ours, atol=1e-4)


def test_creep_is_taken_off_in_the_stream_as_in_the_batch() -> None:
    creep = CreepConfig(fractions=(0.2,), times_s=(1.0,))
    crept = fit_force([series(31), series(32)], creep=creep)
    one = series(33)
    values, _, _ = crept.estimate(one)
    estimator = crept.estimator()
    for index in range(40):
        wrench = estimator.update(int(one.t_us[index]), one.displacement[index])
        np.testing.assert_allclose(wrench.values, values[index], atol=1e-9)
    unaware = dataclasses.replace(crept, creep=CreepConfig())
    assert np.abs(crept.fields(one) - unaware.fields(one)).max() > 0.01


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"schema": 9}', '{"schema": 3, "unit": "mm"}'], ids=repr
)
def test_other_files_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "force.json"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"force\.json"):
        load_force(path)


def more_modes(document: dict[str, Any]) -> None:
    document["modes"] += document["modes"][:20]


@pytest.mark.parametrize(
    "damage",
    [
        lambda document: document.update(reference=[]),
        lambda document: document.update(creep=[]),
        lambda document: document.update(rms=0.0),
        lambda document: document.update(unit="furlong"),
        lambda document: document.update(intervals=document["intervals"][:1]),
        lambda document: document["novelty"].update(deviation=[]),
        lambda document: document.update(centers=[row[1:] for row in document["centers"]]),
        lambda document: document["laws"][2]["parts"][0]["weights"].pop(),
        more_modes,
    ],
)
def test_a_damaged_model_is_refused(
    model: ForceModel, tmp_path: Path, damage: Callable[[dict[str, Any]], Any]
) -> None:
    path = tmp_path / "force.json"
    save_force(model, path)
    document = json.loads(path.read_text())
    damage(document)
    path.write_text(json.dumps(document))
    with pytest.raises(ConfigError, match=r"force\.json' holds no force model"):
        load_force(path)


def test_a_series_of_another_sensor_is_refused(model: ForceModel) -> None:
    one = series(8)
    fewer = WrenchSeries(one.t_us, REFERENCE[:9], one.displacement[:, :9], one.wrench, "mm", "few")
    with pytest.raises(ConfigError, match="few has 9 markers"):
        model.estimate(fewer)
    pixels = WrenchSeries(one.t_us, REFERENCE, one.displacement, one.wrench, "px", "pixels")
    with pytest.raises(ConfigError, match="pixels is in px"):
        model.estimate(pixels)


@pytest.mark.parametrize("shape", [(29, 2), (31, 2), (30, 3), (60,)])
def test_displacements_of_another_sensor_are_refused(
    model: ForceModel, shape: tuple[int, ...]
) -> None:
    with pytest.raises(ConfigError, match=r"30, 2"):
        model.estimator().update(0, np.zeros(shape))


def test_too_little_makes_no_model() -> None:
    one = series(9)
    with pytest.raises(ConfigError, match="50 frames are too few"):
        fit_force([one.part(np.arange(len(one.t_us)) < 50)])
    with pytest.raises(ConfigError, match="no depth"):
        fit_force([one], depth=True)
    bare = WrenchSeries(one.t_us, REFERENCE, one.displacement, one.wrench[:, :0], "mm", "bare")
    with pytest.raises(ConfigError, match="bare holds no wrench"):
        fit_force([bare])
    still = WrenchSeries(
        one.t_us, REFERENCE, np.zeros_like(one.displacement), one.wrench, "mm", "still"
    )
    with pytest.raises(ConfigError, match="still: no marker moves"):
        fit_force([still])
    with pytest.raises(ConfigError, match="no marker moves in its 0 frames"):
        fit_force([one, one.part(one.t_us < 0)])


def test_a_broken_series_is_refused() -> None:
    one = series(1)
    with pytest.raises(RecordingError, match="rows"):
        WrenchSeries(one.t_us, REFERENCE, one.displacement, one.wrench[:5], "mm")
    with pytest.raises(RecordingError, match="7 columns"):
        WrenchSeries(one.t_us, REFERENCE, one.displacement, np.zeros((len(one.t_us), 7)), "mm")
    with pytest.raises(RecordingError, match="2 coordinates"):
        WrenchSeries(one.t_us, REFERENCE[:, :1], one.displacement, one.wrench, "mm")
    broken = one.displacement.copy()
    broken[3, 2, 1] = np.nan
    with pytest.raises(RecordingError, match="not finite"):
        WrenchSeries(one.t_us, REFERENCE, broken, one.wrench, "mm")


@pytest.mark.parametrize(("error", "taken"), [(0.48, 0), (0.40, 1)])  # 0.5 is the first one's
def test_another_law_of_the_normal_force_must_be_clearly_better(
    error: float, taken: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(3)
    truth, noise = rng.normal(size=500), rng.normal(size=500)
    errors = dict(zip(NORMAL, (0.5, error), strict=True))
    between = {law: truth + errors[law] * noise for law in NORMAL}
    assert fit._chosen(truth, between, fit.LEAST_GAINS["fz"]).law == NORMAL[taken]
    assert fit._chosen(truth, between, 0.0).law == NORMAL[1]


def test_remembered_fields_of_drawn_contacts_are_unlike_each_other() -> None:
    rng = np.random.default_rng(4)
    crowd = rng.normal(0.0, 1e-3, (300, 3))
    lone = np.array([[2.0, 0.0, 0.0], [0.0, -1.5, 0.0], [0.0, 0.0, 1.0]])
    places = np.insert(crowd, (50, 120, 290), lone, axis=0)
    chosen = unlike_ones(places, 4)
    apart = np.linalg.norm(chosen[:, np.newaxis] - lone, axis=2).min(axis=0)
    np.testing.assert_array_equal(apart, 0.0)
    assert (np.linalg.norm(chosen, axis=1) < 0.01).sum() == 1
    # The plain twin: each is the field whose variance, given those before, is largest.
    scattered = rng.normal(0.0, 0.8, (60, 3))
    chosen = unlike_ones(scattered, 10)
    for count in range(1, 10):
        known, squares = chosen[:count], (chosen[:count] ** 2).sum(axis=1)
        like = likeness(scattered, known, squares)
        told = like @ np.linalg.solve(likeness(known, known, squares), like.T)
        np.testing.assert_array_equal(chosen[count], scattered[(1.0 - told.diagonal()).argmax()])


def test_drawn_contacts_help_where_labels_are_few() -> None:
    few, *drawn = (series(seed).part(np.arange(780) < 260) for seed in (61, 63, 64))
    few, other = few.part(np.arange(260) < 210), series(62)
    alone, helped = fit_force([few]), fit_force([few], drawn=drawn)
    assert helped.about["series"] == ["series 61", "series 63", "series 64"]
    rms = [
        np.sqrt(((model.estimate(other)[0] - other.wrench) ** 2).mean(axis=0))
        for model in (alone, helped)
    ]
    assert (rms[1] < 0.8 * rms[0]).all()


@pytest.mark.parametrize(
    ("order", "signs", "told"),
    [((1, 0, 2), (1, 1, 1), "fx goes along with fy"), ((0, 1, 2), (1, 1, -1), "with -fz")],
)
def test_labels_must_have_the_axes_of_drawn_contacts(
    order: tuple[int, ...], signs: tuple[int, ...], told: str
) -> None:
    one, *drawn = (series(seed).part(np.arange(780) < 260) for seed in (61, 63, 64))
    assert fit_force([one], drawn=drawn).about["frames"] == 780
    tilted = dataclasses.replace(one, wrench=one.wrench @ [[1, 0, 0.3], [0, 1, 0], [-0.3, 0, 1]])
    assert fit_force([tilted], drawn=drawn).about["frames"] == 780
    turned = dataclasses.replace(one, wrench=one.wrench[:, order] * signs)
    with pytest.raises(ConfigError, match=told):
        fit_force([turned], drawn=drawn)


def test_drawn_contacts_are_learned_from_and_never_judged_by(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    labelled, *drawn = (series(seed).part(np.arange(780) < 100) for seed in (61, 63, 64))
    choose, seen, remembered = fit._choose, {}, []

    def watched(folds: Any, components: int, least_gains: dict[str, float]) -> Any:
        seen["folds"], seen["gains"] = list(folds), least_gains
        return choose(seen["folds"], components, least_gains)

    def counted(places: np.ndarray, count: int) -> np.ndarray:
        remembered.append(count)
        return unlike_ones(places, count)

    monkeypatch.setattr(fit, "_choose", watched)
    monkeypatch.setattr(fit, "unlike_ones", counted)
    model = fit_force([labelled], drawn=drawn)
    # A single series is predicted part by part from its other parts and all that was drawn.
    assert [len(fold.truth) for fold in seen["folds"]] == [100 // fit.PARTS] * fit.PARTS
    taught = [len(fold.taught_wrench) for fold in seen["folds"]]
    assert taught == [100 - 100 // fit.PARTS + 200] * fit.PARTS
    assert seen["gains"] == {}, "a law of drawn contacts needs no clear lead"
    assert model.about["frames"] == 300
    assert len(remembered) == fit.PARTS + 1, "what is remembered is chosen for every fold"
    fit_force([series(61).part(np.arange(780) < 260)])
    assert seen["gains"] == fit.LEAST_GAINS
    assert len(remembered) == fit.PARTS + 1, "of labels alone they are taken evenly"
    assert len(seen["folds"]) == fit.PARTS
