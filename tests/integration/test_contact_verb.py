"""``spikingtac contact`` on simulated recordings, whose contacts are known, and on v2e's."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from spikingtac.sim.catalog import load_scene
from spikingtac.sim.render import simulate
from stand_ins.known import known
from stand_ins.verbs import Verbs


@pytest.fixture(scope="module")
def presses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("presses")
    simulate(load_scene("train-presses"), folder / "one", seed=0, duration_s=2.3)
    return folder / "one"


@pytest.fixture
def calibrated(presses: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "recording"
    shutil.copytree(presses, folder)
    with np.load(folder / "truth.npz") as truth:
        known(truth["reference_px"], truth["radius_px"]).save(folder / "calibration.json")
    return folder


def test_the_default_detector_finds_the_touch_and_its_end(calibrated: Path, verbs: Verbs) -> None:
    with np.load(calibrated / "truth.npz") as truth:
        touched = truth["contact_t_us"][np.abs(truth["force_n"][:, 2]) > 1e-6]
    found = verbs.told("contact", calibrated)
    assert found["detector"] == "default"
    (contact,) = found["contacts"]
    assert 0 < contact["t_us"] - touched[0] < 100_000
    assert abs(contact["end_us"] - touched[-1]) < 100_000
    assert contact["count"] > contact["threshold"]
    assert found["budget_per_hour"] == 1.0
    assert found["quiet"]["source"] == "beginning"
    assert 0.3 <= found["quiet"]["seconds"] <= touched[0] * 1e-6
    assert found["quiet"]["variance"] > 0.0


def test_a_recording_that_begins_with_a_contact(calibrated: Path, verbs: Verbs) -> None:
    with np.load(calibrated / "truth.npz") as truth:
        touched = truth["contact_t_us"][np.abs(truth["force_n"][:, 2]) > 1e-6]
    cut = calibrated / "cut.raw"
    verbs.told("convert", calibrated, cut, "--from-us", int(touched[0]))
    found = verbs.told("contact", cut)
    assert "begins in contact" in verbs.err
    assert (found["quiet"]["source"], found["quiet"]["seconds"]) == ("quietest", 0.3)
    (contact,) = found["contacts"]
    assert 0 < contact["t_us"] - touched[0] < 100_000
    assert abs(contact["end_us"] - touched[-1]) < 100_000


def test_without_a_calibration_events_are_counted_and_it_is_said(
    presses: Path, verbs: Verbs
) -> None:
    assert verbs.told("contact", presses)["detector"] == "event_count"
    assert "event_count" in verbs.said("contact", presses)
    assert "no calibration was given or found" in verbs.err


def test_a_quiet_recording_of_its_own(calibrated: Path, data_dir: Path, verbs: Verbs) -> None:
    found = verbs.told("contact", calibrated, "--quiet", calibrated, "--budget", 5)
    assert found["quiet"]["source"] == "recording"
    assert found["budget_per_hour"] == 5.0
    quiet = "--quiet", data_dir / "v2e" / "quiet.raw"
    v2e = verbs.told("contact", data_dir / "v2e" / "mix.raw", *quiet)
    assert v2e["quiet"]["seconds"] > 2.0
    with np.load(data_dir / "v2e" / "mix.truth.npz") as truth:
        moved = np.abs(truth["marker_px"] - truth["reference_px"]).max(axis=(1, 2)) > 1.0
        first_us = truth["marker_t_us"][int(moved.argmax())]
    assert v2e["contacts"][0]["t_us"] == pytest.approx(first_us, abs=100_000)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--detector", "default"], 1, "needs a calibration"),
        (["--calibration", "a.json", "b.json"], 2, "2 calibrations were given for 1 sensors"),
        (["--calibration", "missing.json"], 1, "spikingtac calibrate"),
    ],
)
def test_refusals(
    presses: Path, arguments: list[str], code: int, message: str, verbs: Verbs
) -> None:
    assert message in verbs.said("contact", presses, *arguments, code=code)
