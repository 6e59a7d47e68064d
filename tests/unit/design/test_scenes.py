"""Scenes on the sensor of a design: the whole way from TOML to events."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from spikingtac.cli.main import main
from spikingtac.events.recording import Recording
from spikingtac.sim.scene import catalog
from spikingtac_hardware.parameters.design import load_design, names
from spikingtac_hardware.twin import scene_with_design


@pytest.mark.parametrize("name", names())
def test_a_recording_of_each_design(name: str, tmp_path: Path) -> None:
    design = load_design(name)
    arguments = ["simulate", "finger-presses", "--design", name, "--duration-s", "0.1"]
    assert main([*arguments, "-o", str(tmp_path / "a"), "--seed", "1"]) == 0
    recording = Recording.open(tmp_path / "a")
    truth = recording.truth() or {}
    assert truth["reference_px"].shape == (design.skin.grid[0] * design.skin.grid[1], 2)
    assert (truth["reference_px"] > 0).all()
    assert (truth["reference_px"] < design.sensor.pixels).all()
    manifest = json.loads((tmp_path / "a" / "manifest.json").read_text())
    assert manifest["size"] == list(design.sensor.pixels)


def test_motion_camera_and_specimen_stay_the_scene_s() -> None:
    scene = catalog.load("finger-presses").with_camera("noisy").with_serial(7)
    ours = scene_with_design(scene, load_design())
    assert ours.contacts == scene.contacts
    assert ours.variation == scene.variation
    assert (ours.camera.preset, ours.skin.serial) == ("noisy", 7)
    assert ours.gel.shear_modulus_kpa == scene.gel.shear_modulus_kpa


def test_dark_dots_have_the_inverse_contrast() -> None:
    scene = scene_with_design(catalog.load("quiet"), load_design("gelsight-like"))
    assert scene.camera.settings["light"]["contrast"] == pytest.approx(1 / 6)


def test_damage_stays_where_the_grid_is_the_same() -> None:
    scene = catalog.load("quiet")
    broken = replace(scene.optics, discs=replace(scene.optics.discs, broken=(60,), missing=(3,)))
    scene = replace(scene, optics=broken)
    same = scene_with_design(scene, load_design()).optics.discs
    other = scene_with_design(scene, load_design("round-fingertip")).optics.discs
    assert (same.broken, same.missing) == ((60,), (3,))
    assert (other.broken, other.missing) == ((), ())


def test_a_design_that_fails_is_no_sensor(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text('based_on = "paper-size"\n[skin]\npitch_mm = 3.0\n')
    assert main(["simulate", "quiet", "--design", str(bad), "-o", str(tmp_path / "a")]) == 2
    assert "disc.inside" in capsys.readouterr().err
    assert not (tmp_path / "a").exists()
