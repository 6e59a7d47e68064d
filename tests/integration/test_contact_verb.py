"""``spikingtac contact`` on simulated recordings, whose contacts are known, and on v2e's."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from spikingtac.events import open_events
from spikingtac.sim.catalog import load_scene
from spikingtac.sim.render import simulate
from stand_ins.known import known
from stand_ins.random_packets import save_events, whole
from stand_ins.verbs import Verbs

HELD_US = 1_270_000, 1_700_000  # The finger holds still in between.


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


@pytest.mark.parametrize("beginning", ["quiet", "in contact", "without noise"])
def test_a_touch_is_found_with_its_end(calibrated: Path, beginning: str, verbs: Verbs) -> None:
    with np.load(calibrated / "truth.npz") as truth:
        touched = truth["contact_t_us"][np.abs(truth["force_n"][:, 2]) > 1e-6]
    before, after = whole(open_events(calibrated)).split(int(touched[0]))
    press, rest = after.split(HELD_US[0])
    if beginning == "without noise":  # silence while the finger holds still
        press.t[:] = touched[0] + (press.t - touched[0]) // 10  # as short as a camera's burst
        rest = rest.split(HELD_US[1])[1]
    parts = [before, press, rest] if beginning == "quiet" else [press, rest]
    found = verbs.told("contact", save_events(calibrated / "parts.raw", *parts))
    assert (found["detector"], found["budget_per_hour"]) == ("default", 1.0)
    (contact,) = found["contacts"]
    assert 0 < contact["t_us"] - touched[0] < 100_000
    assert abs(contact["end_us"] - touched[-1]) < 100_000
    assert contact["count"] > contact["threshold"]
    assert found["quiet"]["source"] == ("beginning" if beginning == "quiet" else "quietest")
    assert 0.3 <= found["quiet"]["seconds"] <= touched[0] * 1e-6
    assert ("begins in contact" in verbs.err) == (beginning == "in contact")


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
