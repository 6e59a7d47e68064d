"""Runs of a short scene: what is kept, what is computed again, and that nothing is mixed."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.open import open_events
from spikingtac.markers.laws import AnchoredLaw
from spikingtac.sim import catalog
from spikingtac.sim.motions import IndenterMotion
from spikingtac.sim.scene import Scene
from spikingtac_paper.harness.run import RunOptions
from spikingtac_paper.point_tracking.cases import DAMAGES, LOOPS, QUICK_MOTION_S, main_trials
from spikingtac_paper.trials import runner as runner_module
from spikingtac_paper.trials.methods import Method
from spikingtac_paper.trials.runner import TrialJob, run_all, run_job
from spikingtac_paper.trials.trial import Trial, shortened
from stand_ins.known import known
from stand_ins.live import MovedBy
from stand_ins.random_packets import rows

TRIAL = Trial(case="short", scene="finger-presses", camera="typical", duration_s=0.1)
BUILT: list[str] = []


def still(calibration: Calibration) -> MovedBy:
    """Build a tracker that says that nothing ever moves."""
    BUILT.append("still")
    return MovedBy(calibration.reference_px)


def table() -> dict[str, Method]:
    return {"still": Method(name="still", about="", tracker="still", rate_hz=1_000.0, build=still)}


def table_with_laws() -> dict[str, Method]:
    return {**table(), "pulled": table()["still"].with_law("pulled", "", AnchoredLaw)}


ONE_WORKER = RunOptions(output=Path(), workers=1)


@pytest.fixture
def known_sensor(monkeypatch: pytest.MonkeyPatch) -> None:
    """The sensor is known from the twin itself: bootstrap slides take longer than this test."""

    def calibration_of(trial: Trial, folder: Path, data: Path | None = None) -> Calibration:
        _, truth = trial.open(folder, data)
        return known(truth.reference_px, truth.radius_px)

    monkeypatch.setattr(runner_module, "calibration_of", calibration_of)


@pytest.mark.usefixtures("known_sensor")
def test_what_has_not_changed_is_not_computed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    BUILT.clear()
    job = TrialJob(trial=TRIAL, methods=("still", "truth"), table=table, folder=tmp_path)
    first = run_all([job], ONE_WORKER)
    assert [record["method"] for record in first] == ["still", "truth"]
    assert BUILT == ["still"]
    assert json.loads(json.dumps(run_job(job))) == json.loads(json.dumps(first))
    assert BUILT == ["still"], "kept"
    next((tmp_path / "scores" / "still").iterdir()).unlink()
    assert run_job(job)[0]["scores"] == first[0]["scores"]
    assert BUILT == ["still", "still"], "scored again"
    monkeypatch.setattr(runner_module, "code_digest", lambda: "other")
    run_job(job)
    assert BUILT == ["still", "still", "still"], "other code is another prediction"


@pytest.mark.usefixtures("known_sensor")
def test_a_law_takes_the_estimates_of_its_tracker(tmp_path: Path) -> None:
    BUILT.clear()
    job = TrialJob(trial=TRIAL, methods=("still", "pulled"), table=table_with_laws, folder=tmp_path)
    still, pulled = run_all([job], ONE_WORKER)
    assert (still["method"], pulled["method"]) == ("still", "pulled")
    assert BUILT == ["still"], "tracked once"
    alone = replace(job, methods=("pulled",), folder=tmp_path / "alone")
    assert run_all([alone], ONE_WORKER)[0]["scores"] == pulled["scores"], (
        "also where only it is asked for"
    )


def test_keys_tell_camera_seed_and_loss_apart() -> None:
    changes = {"seed": 1}, {"loss": 0.3}, {"damaged": 2}, {"camera": "noisy"}
    trials = [TRIAL, *(replace(TRIAL, **change) for change in changes)]
    assert len({trial.key() for trial in trials}) == len(trials)


def test_the_slides_have_noise_of_their_own(tmp_path: Path) -> None:
    # Of equal seeds, 3 of 4 events of a noisy second are the same in any two scenes.
    trial = Trial(case="x", scene="quiet", seed=0, camera="noisy", duration_s=0.3)
    parts = trial, replace(trial.bootstrap(), duration_s=0.3)
    quiet, slides = ({*rows(*open_events(part.record(tmp_path)))} for part in parts)
    assert len(quiet) > 10_000
    assert len(quiet & slides) < 0.01 * len(quiet)


def test_quick_keeps_every_case_of_the_contract_but_fifty_contacts() -> None:
    quick = {case for t in main_trials(range(0, 1), True) for case in (t.case, *t.groups)}
    full = {case for t in main_trials(range(0, 5), False) for case in (t.case, *t.groups)}
    wanted = {"all", "noisy/all", "noisy-loss30/all", "loops", *catalog.TRAJECTORIES}
    wanted |= {f"broken-{count}" for count in DAMAGES}
    assert wanted <= quick
    assert wanted | {"fifty-contacts"} <= full
    assert "fifty-contacts" not in quick


def motion_s(scene: Scene) -> float:
    return sum(IndenterMotion(one.motion).duration_s for one in scene.contacts)


def test_a_quick_run_shortens_the_sequences_and_keeps_the_rest_after_the_release() -> None:
    total_s = np.zeros(2)
    for name in catalog.TRAJECTORIES:
        whole = catalog.load_scene(name)
        short = shortened(whole, QUICK_MOTION_S)
        assert len(short.contacts) <= len(whole.contacts)
        seconds = [motion_s(short), motion_s(whole)]
        assert 1.0 < seconds[0] <= seconds[1], name
        total_s += seconds
        assert short.lead_out_s == whole.lead_out_s
        for contact, other in zip(short.contacts, whole.contacts, strict=False):
            assert contact.motion.segments[-1] == other.motion.segments[-1], "still let go of"
    assert total_s[0] < 0.6 * total_s[1]
    assert all(trial.motion_s is None for trial in main_trials(range(0, 1), False))
    loops = [trial for trial in main_trials(range(0, 1), True) if trial.scene == LOOPS]
    assert [trial.motion_s for trial in loops] == [None], "a loop that is cut short is not closed"
