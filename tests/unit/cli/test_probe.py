"""``spikingtac probe``: what is refused before anything moves, and the forms of a result."""

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from spikingtac import robot
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.cli import probe_sites as sites
from spikingtac.cli.verbs.probe import Args
from spikingtac.robot.robotiq import RobotiqGripper
from spikingtac.types import EventPacket
from stand_ins.known import known
from stand_ins.robotiq_gripper import FakeGripper
from stand_ins.touching import IdealProber
from stand_ins.verbs import Verbs

HOST = "192.0.2.1"
SIZE = (32, 24)


class StillArm:
    """What the verb itself does with an arm: let go of it."""

    closed = 0

    def close(self) -> None:
        StillArm.closed += 1


def lively(args: Args, calibration: Calibration) -> Iterator[tuple[EventPacket, ...]]:
    rng = np.random.default_rng(0)
    for start_us in range(0, 200_000, 1000):
        t = np.sort(rng.integers(start_us, start_us + 1000, 5))
        x, y = (rng.integers(0, edge, 5).astype(np.uint16) for edge in SIZE)
        yield (EventPacket(x, y, t % 2 == 0, t, start_us, start_us + 1000, SIZE),)


def moves(*_: object) -> None:
    raise AssertionError("something moved, or was asked to")


@pytest.fixture
def arm_arguments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """An arm that stands in an ideal hole."""
    known(np.array([[16.0, 12.0]]), size=SIZE).save(tmp_path / "finger.json")
    monkeypatch.setattr(robot, "URArm", lambda address: StillArm())
    monkeypatch.setattr(sites, "listen", lambda args, own: (lively(args, own), None))
    prober = IdealProber(2.0, center_mm=(0.3, -0.2))
    monkeypatch.setattr(robot, "ArmProber", lambda *parts: prober)
    finger = ["--events", "finger.raw", "--calibration", str(tmp_path / "finger.json")]
    return ["probe", "--arm", HOST, *finger, "--rehearsal", "--detector", "event_count"]


def test_an_arm_moves_by_a_recording_only_in_a_rehearsal(
    arm_arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verbs: Verbs
) -> None:
    (tmp_path / "finger.raw").write_bytes(b"")
    monkeypatch.chdir(tmp_path)
    verbs.said(*arm_arguments)
    monkeypatch.setattr(robot, "URArm", moves)
    arm_arguments.remove("--rehearsal")
    assert "feels nothing" in verbs.said(*arm_arguments, code=2)
    verbs.said("probe", "--rehearsal", code=2)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["--radius-mm", "0.3"], "--radius-mm is 0.3; the bit reaches"),
        (["--travel-limit-mm", "0"], "--travel-limit-mm is 0, it must be above 0"),
        (["--contacts", "2"], "contacts is 2"),
        (["--events", "finger.raw"], "--events is used with --arm"),
        (["--travel-mm", "0.2"], "--travel-mm is used with --arm"),
        (["--release"], "--release is used with --gripper"),
        (["--arm", HOST, "--seed", "2"], "--seed is used on the twin"),
        (["-o", "hole.txt"], "the name of a folder"),
        (["-o", __file__], "the name of a folder"),
    ],
)
def test_what_no_search_can_do_is_refused_at_once(
    given: list[str], message: str, monkeypatch: pytest.MonkeyPatch, verbs: Verbs
) -> None:
    monkeypatch.setattr(sites, "on_twin", moves)
    assert message in verbs.said("probe", *given, code=2)


def test_ctrl_c_leaves_no_empty_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verbs: Verbs
) -> None:
    def interrupted(_: Args) -> None:
        assert (tmp_path / "out").is_dir()  # what cannot be written is told before
        raise KeyboardInterrupt

    monkeypatch.setattr(sites, "on_twin", interrupted)
    verbs.said("probe", "-o", tmp_path / "out", code=130)
    assert list(tmp_path.iterdir()) == []


def test_a_real_arm_writes_what_it_found(
    arm_arguments: list[str], tmp_path: Path, verbs: Verbs
) -> None:
    closed = StillArm.closed
    told = verbs.told(*arm_arguments, "-o", tmp_path / "out")
    assert StillArm.closed == closed + 1
    assert (told["source"], told["simulated"], told["contacts"]) == ("robot", False, 12)
    assert "x_mm_error" not in told
    written = json.loads(Path(told["output"]).read_text(encoding="utf-8"))
    assert (written["arm"], written["truth"], written["simulated"]) == (HOST, None, False)
    assert written["method"] == {"search": "default", "detector": "event_count"}
    assert written["config"]["probing"]["force_limit_n"] == 0.5
    assert written["config"]["search"]["contacts"] == 12
    np.testing.assert_allclose(written["center_mm"], (0.3, -0.2), atol=0.02)
    np.testing.assert_allclose(
        np.sqrt(np.diag(written["covariance_mm2"])), written["sigma_mm"], atol=1e-5
    )
    for contact in written["contacts"]:
        assert np.hypot(*contact["direction"]) == pytest.approx(1.0, abs=1e-4)
        assert abs(contact["residual_mm"]) < 0.05
    assert Path(told["picture"]).read_bytes().startswith(b"\x89PNG")


@pytest.fixture
def gripper(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeGripper]:
    """A gripper whose fingers meet the probe at half their way."""
    with FakeGripper(object_at=120) as fake:
        gripper = partial(RobotiqGripper, "127.0.0.1", fake.port)
        monkeypatch.setattr(robot, "RobotiqGripper", lambda address: gripper())
        monkeypatch.setattr(sites, "GRIP_SETTLE_S", 0.0)
        yield fake


@pytest.mark.parametrize(("flags", "position"), [([], 120), (["--release"], 0)])
def test_the_gripper_closes_on_the_probe_and_opens_on_request(
    flags: list[str], position: int, arm_arguments: list[str], gripper: FakeGripper,
    tmp_path: Path, verbs: Verbs,
) -> None:  # fmt: skip
    summary = verbs.told(*arm_arguments, "--gripper", *flags, "-o", tmp_path)
    assert summary["grip"] == {"object": "held", "position": 120}
    assert json.loads((tmp_path / "hole.json").read_text())["grip"] == summary["grip"]
    assert gripper.values["FOR"] == 0
    assert gripper.values["POS"] == position


def test_a_gripper_that_holds_nothing_ends_the_verb_before_the_arm_moves(
    arm_arguments: list[str], gripper: FakeGripper, monkeypatch: pytest.MonkeyPatch, verbs: Verbs
) -> None:
    gripper.object_at = None
    monkeypatch.setattr(robot, "URArm", moves)
    assert "holds nothing" in verbs.said(*arm_arguments, "--gripper", code=3)
