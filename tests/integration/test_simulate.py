"""A scene becomes a recording: files, truth, reproducibility, and what the command line says."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.schema import build
from spikingtac.sim import catalog
from spikingtac.sim.render import simulate
from spikingtac.sim.scene import Scene

# A third of a second on a small sensor.
SMALL = """
lead_in_s = 0.05
lead_out_s = 0.1
skin = { grid = [2, 3] }
optics = { size = [128, 96] }
history = { wait_s = 0.05 }
variation = { place_mm = 0.2, heading_deg = 20.0 }
[[contacts]]
indenter = { kind = "ball" }
[contacts.motion]
height_mm = 0.1
segments = [
  { kind = "press", depth_mm = 0.6, duration_s = 0.1 },
  { kind = "slide", dx_mm = 0.6, duration_s = 0.1 },
  { kind = "release", height_mm = 0.2 },
]
"""


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build(Scene, tomllib.loads(SMALL), "small")


@pytest.fixture(scope="module")
def folder(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("recordings") / "first"
    simulate(scene, target, seed=4)
    return target


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_equal_seeds_give_equal_bytes_and_others_do_not(scene, folder, tmp_path):
    simulate(scene, tmp_path / "again", seed=4)
    simulate(scene, tmp_path / "other", seed=5)
    first, again, other = map(contents, (folder, tmp_path / "again", tmp_path / "other"))
    assert first == again
    assert set(first) == {"events.raw", "truth.npz", "manifest.json"}
    assert all(first[name] != other[name] for name in first)


def test_the_manifest_says_what_was_simulated(scene, folder):
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["schema"] == 1
    assert manifest["size"] == [128, 96]
    assert (manifest["t_start_us"], manifest["seed"], manifest["contrast"]) == (0, 4, 6.0)
    assert manifest["scene_sha256"] == scene.digest()
    assert manifest["threshold_on"] == manifest["threshold_off"] == 0.25
    rebuilt = build(Scene, manifest["scene"], "manifest")
    assert rebuilt.digest() == scene.digest()


def test_the_truth_starts_and_ends_at_rest(scene, folder):
    truth = np.load(folder / "truth.npz")
    markers, times = truth["marker_px"], truth["marker_t_us"]
    assert markers.shape == (len(times), 6, 2)
    assert markers.dtype == np.float32
    np.testing.assert_allclose(truth["radius_px"], 7.0, atol=1.0)
    assert np.diff(times).min() > 0
    assert np.diff(times).max() <= 1000
    np.testing.assert_allclose(markers[0], truth["reference_px"], atol=1e-4)
    away = np.linalg.norm(markers - truth["reference_px"], axis=2)
    assert away.max() > 3.0
    assert away[-1].max() < 0.5
    touched = truth["in_contact"]
    assert 0 < touched.sum() < len(touched)
    assert (truth["force_n"][touched, 2] > 0).all()
    assert (truth["force_n"][~touched] == 0).all()
    cells = len(truth["cell_axis_mm"]) ** 2
    patch = np.unpackbits(truth["touching_cells"], axis=1)
    stuck = np.unpackbits(truth["sticking_cells"], axis=1)
    assert patch.shape == stuck.shape == (len(touched), cells)
    np.testing.assert_array_equal(patch.any(axis=1), touched)
    assert not (stuck & ~patch).any()
    assert stuck.any()
    assert np.abs(truth["torque_n_mm"][touched]).max() > 0


def test_a_foreign_folder_is_left_alone(scene, folder, tmp_path):
    kept = tmp_path / "thesis.txt"
    kept.write_text("years of work")
    with pytest.raises(ConfigError, match=r"holds 'thesis.txt'.*--overwrite"):
        simulate(scene, tmp_path, seed=4)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]
    simulate(scene, tmp_path, seed=4, overwrite=True)
    assert kept.exists()
    with pytest.raises(ConfigError, match=r"holds 'events.raw'.*--overwrite"):
        simulate(scene, folder, seed=4)


def test_what_is_cut_short_leaves_no_half_recording(scene, tmp_path):
    def stop(done: float) -> None:
        if done > 0.2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(scene, tmp_path, seed=4, advance=stop)
    assert list(tmp_path.iterdir()) == []


def test_the_command_lists_scenes_and_writes_a_recording(tmp_path, verbs):
    lines = [line.split("  ", 1) for line in verbs.said("simulate", "--list").splitlines()]
    assert [name for name, _ in lines] == list(catalog.scene_names())
    assert all(about.strip() for _, about in lines)
    arguments = "quiet", "-o", tmp_path / "q", "--duration-s", 0.1, "--camera", "noisy"
    document = verbs.told("simulate", *arguments)
    assert (document["scene"], document["duration_s"]) == ("quiet", 0.1)
    assert document["events"] > 1000  # 1.2 Hz for each of 102,400 pixels
    assert (tmp_path / "q" / "truth.npz").exists()
