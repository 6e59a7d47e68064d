"""The gripper's driver against a fake that speaks its ASCII socket."""

import time

import pytest

from spikingtac.errors import DeviceError
from spikingtac.robot import robotiq
from spikingtac.robot.robotiq import Grip, RobotiqGripper
from stand_ins.robotiq_gripper import FakeGripper


def connect(fake: FakeGripper) -> RobotiqGripper:
    return RobotiqGripper("127.0.0.1", fake.port)


@pytest.fixture
def short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robotiq, "ANSWER_S", 0.2)


@pytest.mark.parametrize("bare_ack", [False, True])
def test_it_activates_and_moves(bare_ack: bool) -> None:
    with FakeGripper() as fake:
        fake.bare_ack = bare_ack
        with connect(fake) as gripper:
            gripper.activate()
            assert fake.values["GTO"] == 1
            assert gripper.move(200, speed=100, force=20) is Grip.AT_POSITION
            assert gripper.position() == 200
            assert (fake.values["SPE"], fake.values["FOR"]) == (100, 20)
            gripper.activate()
            assert gripper.position() == 200


@pytest.mark.usefixtures("short_waits")
def test_silence_and_a_cut_connection_are_reported() -> None:
    with FakeGripper() as fake, connect(fake) as gripper:
        fake.silent = True
        with pytest.raises(DeviceError, match="does not answer"):
            gripper.position()
        fake.drop()
        with pytest.raises(DeviceError, match="does not answer"):
            gripper.position()


@pytest.mark.usefixtures("short_waits")
def test_the_limit_holds_against_an_answer_that_comes_byte_by_byte() -> None:
    with FakeGripper() as fake, connect(fake) as gripper:
        fake.byte_period_s = 0.15  # each byte comes within the limit of 0.2 s, the answer does not
        with pytest.raises(DeviceError, match="does not answer"):
            gripper.position()
        assert fake.sent_bytes < len("POS 3\n") - 1
        fake.byte_period_s = 0.0
        time.sleep(0.2)  # the late answer has come, and is none to another question
        with pytest.raises(DeviceError, match="connect anew"):
            gripper.position()


@pytest.mark.parametrize("answer", ["POS 300", "POS -1", "POS 3.5", "POS"])
def test_an_impossible_position_is_refused(answer: str) -> None:
    with FakeGripper() as fake, connect(fake) as gripper:
        fake.answer_instead = answer
        with pytest.raises(DeviceError, match=f"{answer!r} to GET POS"):
            gripper.position()
