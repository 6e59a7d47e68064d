"""The collision experiment: a run serves every method as the closed loop would."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from spikingtac import windows
from spikingtac.contact.registry import DetectionConfig, make_detector
from spikingtac.robot.approacher import ApproachConfig
from spikingtac.robot.approacher import approach as closed_loop
from spikingtac_paper.collision import experiment
from spikingtac_paper.collision.approach import BEYOND_MM, ApproachRun, approach, prepare, stop_at
from spikingtac_paper.collision.experiment import METHODS, QUICK, CollisionJob, plan, run_job
from spikingtac_paper.collision.scene import DIRECTION, SETTLE_WINDOWS, CollisionScene
from spikingtac_paper.harness.run import RunOptions

SCENE = CollisionScene()
SPEED_MM_S = 180.0
SEED = 2001
NAMES = ("event_count", "default")


@pytest.fixture(scope="module")
def detectors():
    free = SCENE.make_free_rig(SEED, "rested")
    quiet = list(windows([free.advance(4_000)[0]], 1_000))
    calibrations = [SCENE.calibration(free.image.center_px, free.image.radius_px)]
    return {n: make_detector(n, DetectionConfig(), calibrations, quiet) for n in NAMES}


@pytest.fixture(scope="module")
def run(detectors) -> ApproachRun:
    rig = SCENE.make_rig(SEED)
    prepare(rig, SPEED_MM_S, np.random.default_rng(7))
    found = approach(rig, SPEED_MM_S, detectors, None, frozenset(detectors), 4.0)
    for detector in detectors.values():
        detector.reset()
    return found


@pytest.mark.parametrize("name", NAMES)
def test_a_run_is_the_closed_loop(name: str, detectors, run: ApproachRun) -> None:
    rig = SCENE.make_rig(SEED)
    prepare(rig, SPEED_MM_S, np.random.default_rng(7))
    config = ApproachConfig(speed_mm_s=SPEED_MM_S, settle_windows=SETTLE_WINDOWS)
    found = closed_loop(rig.arm, rig.windows(), detectors[name], BEYOND_MM * DIRECTION, config)
    assert found.contact is not None
    assert rig.first_contact.t_us == run.touch.t_us
    assert found.contact.t_us == run.decided_us[name]
    stopped = stop_at(run, run.decided_us[name])
    real_mm = rig.first_contact.arm_mm
    read_mm = (found.collision_mm - real_mm) @ DIRECTION
    assert stopped["read_mm"] == pytest.approx(read_mm, abs=1e-4)
    overshoot_mm = (rig.arm.true_position_mm() - real_mm) @ DIRECTION
    assert stopped["overshoot_mm"] == pytest.approx(overshoot_mm, abs=1e-4)


def test_a_tiny_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(experiment, "QUIET_STEPS", 4_000)
    monkeypatch.setattr(experiment, "STRETCH_STEPS", 1_500)
    base = CollisionJob(folder=tmp_path, scene=SCENE, methods=tuple(METHODS))
    approaches, stretches = plan(QUICK, base)
    one = next(job for job in approaches if job.case == "typical/0.18")
    free = next(job for job in stretches if job.case == "typical/all")
    approached, stretched = run_job(one), run_job(free)
    assert all(outcome is not None for outcome in approached["methods"].values())
    frame = approached["methods"]["frame_sampling"]["deviation_mm"]
    late = approached["methods"]["frame_plus_one"]["deviation_mm"]
    assert late - frame == pytest.approx(SPEED_MM_S * 31.25e-3, rel=0.01)
    assert approached["methods"]["frame_paper"]["deviation_mm"] == pytest.approx(24.3, abs=0.05)
    assert stretched["seconds"] == pytest.approx(0.6)
    assert run_job(one) == approached  # from disk
    monkeypatch.setattr(experiment, "STRETCH_STEPS", 1_200)
    assert run_job(replace(free, seed=free.seed + 1))["seconds"] == pytest.approx(0.3)
    monkeypatch.setattr(experiment, "run_all", lambda *_: ([approached], [stretched]))
    experiment.run(RunOptions(output=tmp_path / "report"))
    rows = json.loads((tmp_path / "report" / "report.json").read_text())["rows"]
    assert {row["method"] for row in rows} >= set(METHODS)
    page = (tmp_path / "report" / "report.html").read_text()
    assert "Not a safety function" in page
    assert SCENE.digest() in page
