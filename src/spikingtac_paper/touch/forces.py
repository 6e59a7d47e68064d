"""Forces of a real gel, each series predicted from the others, and wrenches on the twin's gel.

Simple models to compare with are linear ones and a plain multilayer perceptron.
"""

from collections.abc import Callable, Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim import SceneSource, load_scene
from spikingtac.touch import (
    SkinConfig,
    WrenchSeries,
    fit_force,
    load_series,
    r_squared,
    synthetic_series,
)
from spikingtac.types import FloatArray
from spikingtac_paper.harness.report import Metric
from spikingtac_paper.touch.contacts import record, watch

Estimate = Callable[[WrenchSeries], FloatArray]  # From a series to its wrenches (n, c).

# Penalty per frame, over the variance of a displacement (of 1e-4 to 1e-2 the least errors
# between the series of data/force).
RIDGE_SHARE = 1e-2

# Layers of the perceptron and how it is trained.
WIDTHS, DROPOUT, EPOCHS, BATCH = (512, 256, 128), 0.2, 70, 64
RATE, DECAY = 1e-3, 1e-4  # Its largest learning rate and the decay of its weights.


def mean_displacement(series: Iterable[WrenchSeries]) -> Estimate:
    """Fit the wrench linearly to the markers' mean displacement and its length."""

    def features(one: WrenchSeries) -> FloatArray:
        mean = one.displacement.mean(axis=1)
        length = np.sqrt((one.displacement**2).sum(axis=2)).mean(axis=1)
        return np.column_stack([mean, length, np.ones(len(mean))])

    taught = list(series)
    rows, wrench = np.concatenate([features(one) for one in taught]), _stacked(taught)[1]
    weights = np.linalg.lstsq(rows, wrench, rcond=None)[0]
    return lambda one: features(one) @ weights


def linear_ridge(series: Iterable[WrenchSeries]) -> Estimate:
    """Fit the wrench to all displacements by ridge regression."""
    rows, wrench = _stacked(series)
    middle, level = rows.mean(axis=0), wrench.mean(axis=0)
    away = rows - middle
    penalty = RIDGE_SHARE * len(away) * away.var() * np.eye(away.shape[1])
    weights = np.linalg.solve(away.T @ away + penalty, away.T @ (wrench - level))
    return lambda one: (_stacked([one])[0] - middle) @ weights + level


def perceptron(series: Iterable[WrenchSeries]) -> Estimate:
    """Train a plain multilayer perceptron on all displacements."""
    import torch

    from spikingtac_paper.training.small_networks import Schedule, fit

    rows, wrench = _stacked(series)
    middle, spread, level, size = (
        rows.mean(axis=0), rows.std(axis=0), wrench.mean(axis=0), wrench.std(axis=0)
    )  # fmt: skip
    torch.manual_seed(0)
    layers: list[torch.nn.Module] = []
    for before, width in pairwise((rows.shape[1], *WIDTHS)):
        layers += [torch.nn.Linear(before, width), torch.nn.ReLU(), torch.nn.Dropout(DROPOUT)]
    network = torch.nn.Sequential(*layers, torch.nn.Linear(WIDTHS[-1], wrench.shape[1]))
    known = torch.tensor((rows - middle) / spread, dtype=torch.float32)
    wanted = torch.tensor((wrench - level) / size, dtype=torch.float32)

    def loss(network: torch.nn.Module, chosen: torch.Tensor) -> torch.Tensor:
        return (network(known[chosen]) - wanted[chosen]).square().mean()

    def batches() -> list[torch.Tensor]:
        return list(torch.randperm(len(known)).split(BATCH))

    fit(network, batches, loss, Schedule(rate=RATE, decay=DECAY, epochs=EPOCHS))

    def estimate(one: WrenchSeries) -> FloatArray:
        seen = torch.tensor((_stacked([one])[0] - middle) / spread, dtype=torch.float32)
        with torch.no_grad():
            return np.asarray(network(seen).numpy() * size + level, np.float64)

    return estimate


def _stacked(series: Iterable[WrenchSeries]) -> tuple[FloatArray, FloatArray]:
    """Return displacements ``(n, size)`` and wrenches ``(n, c)`` of series."""
    taught = list(series)
    rows = [one.displacement.reshape(len(one.displacement), -1) for one in taught]
    return np.concatenate(rows), np.concatenate([one.wrench for one in taught])


# Name -> what learns from series.
BASELINES = {"mlp": perceptron, "ridge": linear_ridge, "mean-displacement": mean_displacement}


FOLDER = "force"  # Folder of the series of a real gel below that of the recordings.
FORCES = ("fx", "fy", "fz")
NOISE_PX = 0.1  # Error of a marker's place, per axis, px: that of the tracker ``default``.
STEPS = 3  # Every so many steps of the gel are used.
RATE_HZ = 250.0  # Estimates per second: those of the gel's steps.
TESTED_SEED = 100  # Seed of the tested scenes, from that of the taught ones on.
N_MM_PER_NM = 1e3
TAUGHT = tuple(
    f"train-{kind}" for kind in ("presses", "slides", "torsion", "rubs", "circles", "drag")
)
TESTED = ("finger-presses", "finger-slides", "finger-torsion", "comb-slides", "spoon-circles",
          "finger-rolls", "mixed", "drag-release")  # fmt: skip
QUICK_TESTED = TESTED[:3]

# Cameras through which the tested contacts are also seen, and tracked by ``default``.
CAMERAS = ("typical", "noisy")
RECORDED_METHODS = {
    "force": "ridge regression and Gaussian process on the field's shape (spikingtac force fit)",
    "mlp": "a plain multilayer perceptron, 512-256-128, dropout, 70 epochs (needs torch)",
    "ridge": "a linear ridge regression on the displacements",
    "mean-displacement": "a linear function of the mean displacement and its length",
}
TWIN_METHODS = {
    "physics": "contacts drawn from the skin's equations; stiffness and lens are known, no label",
    "labelled": "learned from labelled contacts of a ball and a punch",
    "physics-and-labels": "learned from both kinds of contacts together",
    "mean-displacement": RECORDED_METHODS["mean-displacement"],
}
METRICS = (
    *(Metric(name.format(one), unit, f"{about} of {one}, series not learned")
      for name, unit, about in (
          ("r2_{}", "R2", "coefficient of determination"),
          ("mae_{}_n", "N", "mean absolute error"),
          ("coverage90_{}", "1", "share of labels in the 90 % intervals"),
      ) for one in FORCES),
    Metric("rms_normal", "1", "rms error of the normal force over its range in the case"),
    Metric("rms_shear", "1", "rms error of the shear forces over the larger range of the two"),
    Metric("rms_torque", "1", "rms error of the torque about the normal over its range"),
)  # fmt: skip


def force_records(folder: Path, methods: list[str]) -> list[dict[str, Any]]:
    """Return the scores of every method on every recorded series and on all pooled."""
    series = [load_series(path) for path in sorted((folder / FOLDER).glob("*.npz"))]
    records = []
    for method in methods:
        parts = []
        for left_out in series if len(series) > 1 else ():
            taught = [one for one in series if one is not left_out]
            parts.append((left_out.wrench[:, :3], *_predicted(method, taught, left_out)))
            case = f"{FOLDER}/{left_out.name.removesuffix('.npz')}"
            records.append(record(method, [case], 0, _force_scores(*parts[-1]), "recorded"))
        if parts:
            pooled = _force_scores(*(np.concatenate(column) for column in zip(*parts, strict=True)))
            each = [_force_scores(*part) for part in parts]
            mean = {name: float(np.mean([one[name] for one in each])) for name in pooled}
            records.append(record(method, [f"{FOLDER}/pooled"], 0, pooled, "recorded"))
            records.append(record(method, [f"{FOLDER}/mean"], 0, mean, "recorded"))
    return records


def _predicted(
    method: str, taught: list[WrenchSeries], left_out: WrenchSeries
) -> tuple[FloatArray, FloatArray]:
    """Return forces ``(n, 3)`` of a series and their 90 % half-widths, nan where none is stated."""
    if method == "force":
        values, widths = fit_force(taught).estimate(left_out)
        return values[:, :3], widths[:, :3]
    flat = [one.in_image() for one in taught]
    estimate = BASELINES[method](flat)(left_out.in_image())
    return estimate[:, :3], np.full((len(estimate), 3), np.nan)


def _force_scores(truth: FloatArray, estimate: FloatArray, width: FloatArray) -> dict[str, float]:
    scores = {}
    for k, name in enumerate(FORCES):
        error = np.abs(truth[:, k] - estimate[:, k])
        scores[f"r2_{name}"] = r_squared(truth[:, k], estimate[:, k])
        scores[f"mae_{name}_n"] = float(error.mean())
        if np.isfinite(width).all():
            scores[f"coverage90_{name}"] = float((error <= width[:, k]).mean())
    return scores


def wrench_records(methods: list[str], seed: int, quick: bool) -> list[dict[str, Any]]:
    """Return the scores of every method on every scene of the twin and on all together."""
    names, own = QUICK_TESTED if quick else TESTED, seed + TESTED_SEED
    tested = {"wrench": [gel_series(name, own) for name in names]}
    for camera in CAMERAS:
        tested[f"wrench-{camera}"] = [tracked_series(name, own, camera) for name in names]
    taught = [gel_series(name, seed) for name in TAUGHT]
    records = []
    for method in methods:
        estimate_of = _estimator(method, taught, tested["wrench"][0].reference)
        for group, series in tested.items():
            estimates = [estimate_of(one)[:, :6] for one in series]
            truth = [one.wrench for one in series]
            parts = [*zip(names, truth, estimates, strict=True),
                     ("all", np.concatenate(truth), np.concatenate(estimates))]  # fmt: skip
            for name, true, told in parts:
                records.append(
                    record(method, [f"{group}/{name}"], seed, _wrench_scores(true, told))
                )
    return records


def gel_series(name: str, seed: int) -> WrenchSeries:
    """Return a scene's markers, as a tracker would see them, and its wrench."""
    source = SceneSource(load_scene(name), seed)
    rng = np.random.default_rng(seed)
    times, moved, wrench = [], [], []
    for number, (state, image) in enumerate(source.frames()):
        if number % STEPS:
            continue
        away = image.center_px - source.reference_px
        times.append(state.t_us)
        moved.append(away + rng.normal(0.0, NOISE_PX, away.shape))
        wrench.append(np.concatenate([state.force_n, state.torque_n_mm / N_MM_PER_NM]))
    t_us = np.array(times, np.int64)
    return WrenchSeries(t_us, source.reference_px, np.array(moved), np.array(wrench), "px", name)


def tracked_series(name: str, seed: int, camera: str) -> WrenchSeries:
    """Return what `default` tracks of a scene through a camera's preset, and the wrench."""
    source = SceneSource(load_scene(name).with_camera(camera), seed)
    true_us: list[NDArray[np.int64]] = []
    wrench: list[FloatArray] = []

    def note(step: Any) -> None:
        true_us.append(step.truth.contact_t_us)
        wrench.append(np.hstack([step.truth.force_n, step.truth.torque_n_mm / N_MM_PER_NM]))

    frames = [(frame.t_us, frame.detected_px) for frame in watch(source, note, RATE_HZ)]
    t_us, places = (np.array(column) for column in zip(*frames, strict=True))
    known_us, known = np.concatenate(true_us), np.concatenate(wrench)
    at_frames = np.column_stack([np.interp(t_us, known_us, column) for column in known.T])
    moved = places - source.reference_px
    return WrenchSeries(t_us, source.reference_px, moved, at_frames, "px", name)


def _estimator(method: str, taught: list[WrenchSeries], reference: FloatArray) -> Estimate:
    """Return what gives a method's wrenches ``(n, c)`` of a series."""
    if method == "mean-displacement":
        return mean_displacement(taught)
    drawn = [] if method == "labelled" else _drawn(reference)
    model = fit_force([*drawn] if method == "physics" else [*taught, *drawn])
    return lambda series: model.estimate(series)[0]


def _drawn(reference: FloatArray) -> list[WrenchSeries]:
    """Return contacts drawn from the equations of the tested skin."""
    scene = load_scene(TESTED[0])
    skin = SkinConfig(
        shear_modulus_kpa=scene.gel.shear_modulus_kpa,
        thickness_mm=scene.gel.thickness_mm,
        camera_distance_mm=scene.optics.distance_mm,
    )
    size_px, size_mm = (np.ptp(rest, axis=0).mean() for rest in (reference, scene.skin.rest_mm()))
    return synthetic_series(skin, reference, float(size_px / size_mm))


def _wrench_scores(truth: FloatArray, estimate: FloatArray) -> dict[str, float]:
    rms = np.sqrt(((truth - estimate) ** 2).mean(axis=0))
    spread = np.ptp(truth, axis=0)
    scores = {"rms_normal": float(rms[2] / spread[2])}
    if spread[:2].max() > 0.1 * spread[2]:
        scores["rms_shear"] = float(rms[:2].max() / spread[:2].max())
        scores["rms_torque"] = float(rms[5] / spread[5])
    return scores
