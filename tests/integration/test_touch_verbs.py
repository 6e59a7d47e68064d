"""The verbs ``touch`` and ``force`` from the command line."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import spikingtac as st
from spikingtac import touch
from spikingtac.cli.main import main

X, Y = np.meshgrid(np.arange(6.0), np.arange(5.0))
REFERENCE = np.column_stack([X.ravel(), Y.ravel(), 0 * X.ravel()]) * 1.5


def arrays(path: Path, seed: int) -> Path:
    """Four presses a second apart, with the wrench that made them."""
    rng = np.random.default_rng(seed)
    t_us = np.arange(0, 5_000_000, 10_000, dtype=np.int64)
    share = np.clip(np.sin(np.pi * t_us / 5e5), 0.0, 1.0) ** 2 * (t_us > 900_000)
    depth = 0.3 + 0.2 * np.floor(t_us / 1e6) / 4
    away = REFERENCE - REFERENCE.mean(axis=0)
    pattern = away * np.exp(-0.5 * (away**2).sum(axis=1, keepdims=True) / 4.0)
    moved = (share * depth)[:, None, None] * pattern + rng.normal(0, 0.004, (500, 30, 3))
    force = np.zeros((500, 6))
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


def test_tracks_keep_their_scale(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tracks_of(tmp_path / "arrays.npz", 24.0 * REFERENCE[:, :2] + 50.0)
    with np.load(file) as arrays_alone:
        t_us, places = arrays_alone["t_us"], arrays_alone["detected_px"]
        rest = arrays_alone["reference_px"]
    common = {
        "position_px": places,
        "displacement_px": places - rest,
        "coasted": np.zeros(places.shape[:2], bool),
        "confidence": np.ones(places.shape[:2]),
    }
    tracks = st.Tracks(
        t_us=t_us, detected_px=places, reference_px=rest, meta={"px_per_mm": 24.0}, **common
    )
    tracks.save(tmp_path / "tracks.npz")
    assert main(["touch", str(tmp_path / "tracks.npz"), "--json"]) == 0
    touches = json.loads(capsys.readouterr().out)["touches"]
    assert touches
    for one in touches:
        np.testing.assert_allclose(one["place_mm"], np.array(one["place_px"]) / 24, atol=1e-4)
        assert one["area_mm2"] == pytest.approx(one["area_px2"] / 24**2, abs=1e-3)
        field = one["field"]
        assert field["mean_shear_x_mm"] == pytest.approx(field["mean_shear_x_px"] / 24, abs=1e-5)
        peak = (places - rest)[np.searchsorted(t_us, one["peak_us"])]
        assert field["mean_shear_x_px"] == pytest.approx(peak[:, 0].mean(), abs=0.05)
        assert field["mean_shear_y_px"] == pytest.approx(peak[:, 1].mean(), abs=0.05)
        assert 0.0 <= field["strain"] < one["peak_strength"]  # without the share of noise


def test_forces_are_learned_and_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    taught = [str(arrays(tmp_path / f"{seed}.npz", seed)) for seed in (1, 2)]
    other, model = str(arrays(tmp_path / "3.npz", 3)), str(tmp_path / "force.onnx")
    assert main(["force", "fit", *taught, "-o", model, "--json"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["frames"] == 1000
    assert main(["force", "check", other, "--force", model, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row["component"] for row in rows] == ["fx", "fy", "fz", "mx", "my", "mz"]
    assert rows[2]["r2"] > 0.95
    assert set(rows[0]) >= {"component", "r2", "mae", "coverage90"}
    assert main(["force", "check", other, "--force", model]) == 0
    assert "fz" in capsys.readouterr().out
    assert main(["force", "fit", *taught, "-o", model]) == 2
    assert "--overwrite" in capsys.readouterr().err


def test_forces_are_added_to_tracks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, model = arrays(tmp_path / "a.npz", 1), tmp_path / "force.onnx"
    assert main(["force", "fit", str(source), "-o", str(model)]) == 0
    out = tmp_path / "forces.npz"
    line = ["force", "apply", str(source), "--force", str(model)]
    assert main([*line, "-o", str(out), "--json"]) == 0
    peak_n = json.loads(capsys.readouterr().out.splitlines()[-1])["peak_force_n"]
    with np.load(out) as after, np.load(source) as before:
        assert set(after.files) == {*before.files, "force_n", "force_sigma_n", "torque_nm"}
        assert np.abs(after["force_n"] - before["wrench"][:, :3]).mean() < 0.05
        assert peak_n == pytest.approx(np.linalg.norm(after["force_n"], axis=1).max(), abs=1e-3)
        assert (after["force_sigma_n"] >= 0).all()
    assert main([*line, "-o", str(out)]) == 2
    assert main(line) == 2
    assert "-o OUT" in capsys.readouterr().err
    other = tmp_path / "other.onnx"
    assert (
        main(["force", "fit", str(source), "--from", str(model), "-o", str(other), "--json"]) == 0
    )
    assert json.loads(capsys.readouterr().out)["r2_between_series"]["fz"] > 0.9
    assert main(["force", "check", str(source), "--from", str(model)]) == 2
    assert "--from is used to fit" in capsys.readouterr().err


def test_a_skin_of_known_stiffness_needs_no_labels(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    few = partial(touch.synthetic_series, frames=40)
    monkeypatch.setattr(touch, "synthetic_series", few)
    places = 37.0 * REFERENCE[:, :2] / 1.5 + 40.0
    document = {
        "schema": 1,
        "size": [320, 320],
        "grid": [5, 6],
        "reference_px": places.tolist(),
        "radius_px": [7.0] * 30,
    }
    bare, scaled = tmp_path / "bare.json", tmp_path / "scaled.json"
    bare.write_text(json.dumps(document))
    scaled.write_text(json.dumps({**document, "px_per_mm": 15.4}))
    model = str(tmp_path / "force.onnx")
    words = ["force", "fit", "--shear-modulus-kpa", "30", "-o", model]
    assert main(words) == 2
    assert "--calibration" in capsys.readouterr().err
    assert main([*words, "--calibration", str(bare)]) == 2
    assert "--pitch-mm" in capsys.readouterr().err
    assert main([*words, "--calibration", str(scaled), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["unit"] == "px"
    near = [*words, "--overwrite", "--calibration", str(scaled), "--camera-distance-mm"]
    assert main([*near, "2"]) == 2
    assert "thickness, 3.0 mm" in capsys.readouterr().err
    labelled = tracks_of(tmp_path / "labelled.npz", places)
    assert main([*near, "13", str(labelled), "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["series"]) == 7
    assert main(["force", "fit", str(labelled), "--camera-distance-mm", "13"]) == 2
    assert "needs --shear-modulus-kpa" in capsys.readouterr().err
    assert main([*words, "--overwrite", str(arrays(tmp_path / "a.npz", 1))]) == 2
    assert "--calibration" in capsys.readouterr().err
