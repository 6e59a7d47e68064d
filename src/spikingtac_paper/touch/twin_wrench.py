"""Wrenches on the twin's gel: contacts that were not learned, other bodies, other seeds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim import SceneSource, load_scene
from spikingtac.touch import (
    SkinConfig,
    WrenchSeries,
    fit_force,
    synthetic_series,
)
from spikingtac_paper.harness.report import Metric
from spikingtac_paper.touch.baselines import MeanDisplacement
from spikingtac_paper.touch.tracked_wrench import N_MM_PER_NM, tracked_series

Field = NDArray[np.float64]

NOISE_PX = 0.1
"""Error of a marker's place, per axis, px: that of the tracker ``default`` (ours)."""
STEPS = 3
"""Every so many steps of the gel are used."""
TAUGHT = tuple(
    f"train-{kind}" for kind in ("presses", "slides", "torsion", "rubs", "circles", "drag")
)
TESTED = ("finger-presses", "finger-slides", "finger-torsion", "comb-slides", "spoon-circles",
          "finger-rolls", "mixed", "drag-release")  # fmt: skip
QUICK_TESTED = TESTED[:3]
CAMERAS = ("typical", "noisy")
"""Cameras through which the tested contacts are also seen, and tracked by ``default``."""
METHODS = {
    "physics": "contacts drawn from the skin's equations; stiffness and lens are known, no label",
    "labelled": "learned from labelled contacts of a ball and a punch",
    "physics-and-labels": "learned from both kinds of contacts together",
    "mean-displacement": "a linear function of the mean displacement and its length",
}
METRICS = (
    Metric("rms_normal", "1", "rms error of the normal force over its range in the case"),
    Metric("rms_shear", "1", "rms error of the shear forces over the larger range of the two"),
    Metric("rms_torque", "1", "rms error of the torque about the normal over its range"),
)


def wrench_records(methods: list[str], seed: int, quick: bool) -> list[dict[str, Any]]:
    """Return the scores of every method on every scene and on all together."""
    names = QUICK_TESTED if quick else TESTED
    tested = {"wrench": [gel_series(name, seed + 100) for name in names]}
    for camera in CAMERAS:
        seen = [tracked_series(name, seed + 100, camera) for name in names]
        tested[f"wrench-{camera}"] = seen
    taught = [gel_series(name, seed) for name in TAUGHT]
    records = []
    for method in methods:
        estimate_of = _estimator(method, taught, tested["wrench"][0].reference)
        for group, series in tested.items():
            estimates = [estimate_of(one)[:, :6] for one in series]
            for name, one, estimate in zip(names, series, estimates, strict=True):
                records.append(_record(method, f"{group}/{name}", one.wrench, estimate, seed))
            truth = np.concatenate([one.wrench for one in series])
            records.append(_record(method, f"{group}/all", truth, np.concatenate(estimates), seed))
    return records


def gel_series(name: str, seed: int) -> WrenchSeries:
    """Return a scene's markers, as a tracker would see them, and its wrench."""
    scene = load_scene(name)
    source = SceneSource(scene, seed)
    rng = np.random.default_rng(seed)
    times, moved, wrench = [], [], []
    for number, (state, image) in enumerate(source.frames()):
        if number % STEPS:
            continue
        noisy = image.center_px - source.reference_px
        noisy = noisy + rng.normal(0.0, NOISE_PX, noisy.shape)
        times.append(state.t_us)
        moved.append(noisy)
        wrench.append(np.concatenate([state.force_n, state.torque_n_mm / N_MM_PER_NM]))
    return WrenchSeries(
        np.array(times, np.int64),
        source.reference_px,
        np.array(moved),
        np.array(wrench),
        "px",
        name,
    )


def _estimator(
    method: str, taught: list[WrenchSeries], reference: Field
) -> Callable[[WrenchSeries], Field]:
    """Return what gives a method's wrenches ``(n, c)`` of a series."""
    if method == "mean-displacement":
        return MeanDisplacement(taught).estimate
    drawn = [] if method == "labelled" else _drawn(reference)
    model = fit_force([*drawn] if method == "physics" else [*taught, *drawn])
    return lambda series: model.estimate(series)[0]


def _drawn(reference: Field) -> list[WrenchSeries]:
    scene = load_scene(TESTED[0])
    skin = SkinConfig(
        shear_modulus_kpa=scene.gel.shear_modulus_kpa,
        thickness_mm=scene.gel.thickness_mm,
        camera_distance_mm=scene.optics.distance_mm,
    )
    return synthetic_series(skin, reference, _px_per_mm(reference))


def _px_per_mm(reference: Field) -> float:
    rest_mm = load_scene(TESTED[0]).skin.rest_mm()
    return float(np.ptp(reference, axis=0).mean() / np.ptp(rest_mm, axis=0).mean())


def _record(method: str, case: str, truth: Field, estimate: Field, seed: int) -> dict[str, Any]:
    rms = np.sqrt(((truth - estimate) ** 2).mean(axis=0))
    spread = np.ptp(truth, axis=0)
    scores = {"rms_normal": float(rms[2] / spread[2])}
    if spread[:2].max() > 0.1 * spread[2]:
        scores["rms_shear"] = float(rms[:2].max() / spread[:2].max())
        scores["rms_torque"] = float(rms[5] / spread[5])
    trial = {"case": case, "groups": [], "seed": seed, "source": "twin"}
    return {"method": method, "trial": trial, "scores": scores}
