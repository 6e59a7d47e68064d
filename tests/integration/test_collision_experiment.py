"""The collision experiment: a run serves every method as the closed loop would."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from spikingtac.config import digest
from spikingtac.contact.registry import DetectionConfig, make_detector
from spikingtac.robot.approacher import ApproachConfig, Approacher
from spikingtac_paper.collision import jobs as collision_jobs
from spikingtac_paper.collision.approach_run import (
    BEYOND_MM,
    ApproachRun,
    Observers,
    approach,
    prepare,
    stop_at,
)
from spikingtac_paper.collision.experiment import make_report
from spikingtac_paper.collision.jobs import CollisionJob, run_job
from spikingtac_paper.collision.methods import collision_methods
from spikingtac_paper.collision.plan import CollisionConfig, plan
from spikingtac_paper.collision.scene import SETTLE_WINDOWS, CollisionScene
from spikingtac_paper.harness.records import load_record
from spikingtac_paper.harness.report import find_row
from spikingtac_paper.harness.report_files import write_report

SCENE = CollisionScene()
SPEED_MM_S = 180.0
SEED = 2001
NAMES = ("event_count", "default")


@pytest.fixture(scope="module")
def detectors():
    free = SCENE.make_free_rig(SEED, "rested")
    quiet = list(free.windows(4_000))
    calibrations = [SCENE.calibration(free)]
    return {n: make_detector(n, DetectionConfig(), calibrations, quiet) for n in NAMES}


@pytest.fixture(scope="module")
def run(detectors) -> ApproachRun:
    rig = SCENE.make_rig(SEED)
    prepare(rig, SCENE, SPEED_MM_S, np.random.default_rng(7))
    required = frozenset(detectors)
    observers = Observers(detectors=detectors, frames=None, required=required, patience_mm=4.0)
    found = approach(rig, SCENE, SPEED_MM_S, observers)
    for detector in detectors.values():
        detector.reset()
    return found


@pytest.mark.parametrize("name", NAMES)
def test_a_run_is_the_closed_loop(name: str, detectors, run: ApproachRun) -> None:
    rig = SCENE.make_rig(SEED)
    prepare(rig, SCENE, SPEED_MM_S, np.random.default_rng(7))
    config = ApproachConfig(speed_mm_s=SPEED_MM_S, settle_windows=SETTLE_WINDOWS)
    approacher = Approacher(rig.arm, rig.windows(), detectors[name], config)
    found = approacher.approach(BEYOND_MM * SCENE.direction)
    assert found.contact is not None
    assert rig.first_contact is not None
    assert rig.first_contact.t_us == run.touch.t_us
    assert found.contact.t_us == run.decided_us[name]
    stopped = stop_at(run, run.decided_us[name], SCENE.direction)
    real_mm = rig.first_contact.arm_mm
    assert stopped.deviation_mm == pytest.approx(found.deviation_mm(real_mm), abs=1e-4)
    read = found.deviation_mm(real_mm, true=False)
    assert stopped.read_mm == pytest.approx(read, abs=1e-4)
    assert stopped.overshoot_mm == pytest.approx(found.overshoot_mm(real_mm), abs=1e-4)


def test_the_touch_comes_a_second_after_the_release(run: ApproachRun) -> None:
    stopped = stop_at(run, run.touch.t_us, SCENE.direction)
    assert stopped.deviation_mm == pytest.approx(0.0, abs=1e-3)
    assert 4.5 < stopped.overshoot_mm < 7.7
    assert run.touch.t_us - run.first_us > 20_000


def test_a_tiny_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collision_jobs, "QUIET_STEPS", 4_000)
    whole = plan(CollisionConfig.quick())
    names = tuple(collision_methods())
    one = next(task for task in whole.approaches if task.case == "typical/0.18")
    stretch = next(task for task in whole.stretches if task.case == "typical/all")
    jobs = [
        CollisionJob(folder=tmp_path, task=task, methods=names)
        for task in (one, replace(stretch, steps=1_500))
    ]
    approached, stretched = (run_job(job) for job in jobs)
    assert all(outcome is not None for outcome in approached["methods"].values())
    frame = approached["methods"]["frame_sampling"]["deviation_mm"]
    late = approached["methods"]["frame_plus_one"]["deviation_mm"]
    assert late - frame == pytest.approx(SPEED_MM_S * 31.25e-3, rel=0.01)
    paper = approached["methods"]["frame_paper"]["deviation_mm"]
    assert paper == pytest.approx(24.3, abs=0.05)
    assert stretched["seconds"] == pytest.approx(0.6)
    assert run_job(jobs[0]) == approached  # from disk
    report = make_report([approached], [stretched], {"command": "test"})
    write_report(report, tmp_path)
    rows = json.loads((tmp_path / "report.json").read_text())["rows"]
    assert {row["method"] for row in rows} >= set(names)
    assert find_row(report.rows, "zero_delay", "typical/0.18", "overshoot_mean_mm") is not None
    page = (tmp_path / "report.html").read_text()
    assert "Not a safety function" in page
    assert digest(SCENE.resolved()) in page


def test_results_of_another_length_are_not_taken_for_these(tmp_path: Path) -> None:
    stretch = plan(CollisionConfig.quick()).stretches[0]
    keys = {
        collision_jobs.job_key(task, ("default",), ())
        for task in (stretch, replace(stretch, steps=7), replace(stretch, seed=1))
    }
    assert len(keys) == 3
    assert not any(load_record(tmp_path / "none.json", key) for key in keys)
