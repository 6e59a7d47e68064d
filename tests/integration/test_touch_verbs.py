"""The verbs ``touch`` and ``force`` from the command line."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest

import spikingtac as st
from spikingtac import touch
from stand_ins.known import known
from stand_ins.verbs import Verbs

X, Y = np.meshgrid(np.arange(6.0), np.arange(5.0))
REFERENCE = np.column_stack([X.ravel(), Y.ravel(), 0 * X.ravel()]) * 1.5


def arrays(path: Path, seed: int) -> Path:
    """Four presses a second apart, with the wrench that made them."""
    rng = np.random.default_rng(seed)
    t_us = np.arange(0, 5_000_000, 20_000, dtype=np.int64)
    share = np.clip(np.sin(np.pi * t_us / 5e5), 0.0, 1.0) ** 2 * (t_us > 900_000)
    depth = 0.3 + 0.2 * np.floor(t_us / 1e6) / 4
    away = REFERENCE - REFERENCE.mean(axis=0)
    pattern = away * np.exp(-0.5 * (away**2).sum(axis=1, keepdims=True) / 4.0)
    moved = (share * depth)[:, None, None] * pattern + rng.normal(0, 0.004, (250, 30, 3))
    force = np.zeros((250, 6))
    force[:, 2] = -4 * share * depth
    force[:, 0] = 0.5 * share * depth
    np.savez(path, t_us=t_us, reference_mm=REFERENCE, displacement_mm=moved, wrench=force)
    return path


def tracks_of(path: Path, places_px: np.ndarray) -> Path:
    """Write the same presses as tracks of markers at these places, px; pressing is positive fz."""
    with np.load(arrays(path, 2)) as file:
        moved_px = 24.0 * file["displacement_mm"][:, :, :2]
        wrench = file["wrench"] * [1, 1, -1, 1, 1, 1]
        np.savez(path, t_us=file["t_us"], reference_px=places_px,
                 detected_px=places_px + moved_px, wrench=wrench)  # fmt: skip
    return path


def test_tracks_keep_their_scale(tmp_path: Path, verbs: Verbs) -> None:
    file = tracks_of(tmp_path / "arrays.npz", 24.0 * REFERENCE[:, :2] + 50.0)
    with np.load(file) as arrays_alone:
        t_us, places = arrays_alone["t_us"], arrays_alone["detected_px"]
        rest = arrays_alone["reference_px"]
    lost = np.zeros(places.shape[:2], bool)
    tracks = st.Tracks(t_us, places, places, places - rest, lost, ~lost * 1.0, rest,
                       meta={"px_per_mm": 24.0})  # fmt: skip
    tracks.save(tmp_path / "tracks.npz")
    touches = verbs.told("touch", tmp_path / "tracks.npz")["touches"]
    assert touches
    for one in touches:
        np.testing.assert_allclose(one["place_mm"], np.array(one["place_px"]) / 24, atol=1e-4)
        assert one["area_mm2"] == pytest.approx(one["area_px2"] / 24**2, abs=1e-3)
        field = one["field"]
        assert field["mean_shear_x_mm"] == pytest.approx(field["mean_shear_x_px"] / 24, abs=1e-5)
        peak = (places - rest)[np.searchsorted(t_us, one["peak_us"])]
        for axis, name in enumerate(("mean_shear_x_px", "mean_shear_y_px")):
            assert field[name] == pytest.approx(peak[:, axis].mean(), abs=0.05)
        assert 0.0 <= field["strain"] < one["peak_strength"]  # without the share of noise


def test_forces_are_learned_and_checked(tmp_path: Path, verbs: Verbs) -> None:
    taught = [arrays(tmp_path / f"{seed}.npz", seed) for seed in (1, 2)]
    other, model = arrays(tmp_path / "3.npz", 3), tmp_path / "force.onnx"
    assert verbs.told("force", "fit", *taught, "-o", model)["frames"] == 500
    rows = verbs.told("force", "check", other, "--force", model)["rows"]
    assert [row["component"] for row in rows] == ["fx", "fy", "fz", "mx", "my", "mz"]
    assert rows[2]["r2"] > 0.95
    assert set(rows[0]) >= {"component", "r2", "mae", "coverage90"}
    assert "fz" in verbs.said("force", "check", other, "--force", model)
    assert "--overwrite" in verbs.said("force", "fit", *taught, "-o", model, code=2)


def test_forces_are_added_to_tracks(tmp_path: Path, verbs: Verbs) -> None:
    source, model = arrays(tmp_path / "a.npz", 1), tmp_path / "force.onnx"
    verbs.said("force", "fit", source, "-o", model)
    out = tmp_path / "forces.npz"
    line = ["force", "apply", source, "--force", model]
    peak_n = verbs.told(*line, "-o", out)["peak_force_n"]
    with np.load(out) as after, np.load(source) as before:
        assert set(after.files) == {*before.files, "force_n", "force_sigma_n", "torque_nm"}
        assert np.abs(after["force_n"] - before["wrench"][:, :3]).mean() < 0.05
        assert peak_n == pytest.approx(np.linalg.norm(after["force_n"], axis=1).max(), abs=1e-3)
        assert (after["force_sigma_n"] >= 0).all()
        np.savez(tmp_path / "s.npz", **{**before, "t_us": before["t_us"] / 1e6})
        np.savez(tmp_path / "w.npz", **{**before, "displacement_mm": 5 * before["displacement_mm"]})
    line[2] = tmp_path / "s.npz"
    assert "whole microseconds" in verbs.said(*line, "-o", tmp_path / "x.npz", code=1)
    line[2] = tmp_path / "w.npz"
    assert verbs.told(*line, "-o", tmp_path / "x.npz")["beyond_learned"] > 0.3
    verbs.said(*line, "-o", out, code=2)
    assert "-o OUT" in verbs.said(*line, code=2)
    again = verbs.told("force", "fit", source, "--from", model, "-o", tmp_path / "other.onnx")
    assert again["r2_between_series"]["fz"] > 0.9
    assert "--from is used to fit" in verbs.said("force", "check", source, "--from", model, code=2)


def test_a_skin_of_known_stiffness_needs_no_labels(
    tmp_path: Path, verbs: Verbs, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(touch, "synthetic_series", partial(touch.synthetic_series, frames=35))
    places = 37.0 * REFERENCE[:, :2] / 1.5 + 40.0
    bare, scaled = tmp_path / "bare.json", tmp_path / "scaled.json"
    known(places, grid=(5, 6)).save(bare)
    known(places, grid=(5, 6), px_per_mm=15.4).save(scaled)
    words = ["force", "fit", "--shear-modulus-kpa", 30, "-o", tmp_path / "force.onnx"]
    assert "--calibration" in verbs.said(*words, code=2)
    assert f"calibrate {bare} -o" in verbs.said(*words, "--calibration", bare, code=2)
    assert "spikingtac track" in verbs.said("force", "fit", bare, code=1)
    assert verbs.told(*words, "--calibration", scaled)["unit"] == "px"
    near = [*words, "--overwrite", "--calibration", scaled, "--camera-distance-mm"]
    assert "thickness, 3.0 mm" in verbs.said(*near, 2, code=2)
    labelled = 13, tracks_of(tmp_path / "labelled.npz", places)
    assert len(verbs.told(*near, *labelled)["series"]) == 7
    assert "needs --shear-modulus-kpa" in verbs.said(*words[:2], near[-1], *labelled, code=2)
    words += ["--overwrite", arrays(tmp_path / "a.npz", 1)]
    assert "--calibration" in verbs.said(*words, code=2)
