"""The contact path in its own process: contact, and whatever can fail, stops the arm."""

import time
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from spikingtac.robot.guard import ContactProcess
from spikingtac.robot.ur import WATCHDOG_HZ
from spikingtac.robot.ur_stop import REST_MM_S
from spikingtac.robot.watchdog import Watchdog
from stand_ins.guarded import (
    NEVER,
    SLOW_S,
    NotingArm,
    SlowArm,
    long_failure,
    moving_ur,
    paced,
    stops,
    watching,
)
from stand_ins.ur_controller import EVERYTHING, WATCHDOG, URController
from stand_ins.waiting import PATIENCE_S, SLACK_S, wait_until

pytestmark = pytest.mark.waits


# Far above the 40 ms that a robot is given, so that a busy machine's pauses are no silence.
STALE_S = 2.0

# A busy machine may let the controller's own watchdog end the first start: the guard refuses.
STARTS = 6
TOUCH = 150  # Window at which something happens: 0.75 s after the stream was opened.

# A touch whose time is compared: a busy machine, late at first, has caught up by then.
LATE_TOUCH = 300
CALM = partial(Watchdog, stale_s=STALE_S, backlog_s=60.0)
PATIENT = partial(Watchdog, stale_s=60.0, backlog_s=60.0)


@pytest.fixture
def notes(tmp_path: Path) -> Path:
    return tmp_path / "stops"


@pytest.fixture
def guard(notes: Path) -> Iterator[Any]:
    made: list[ContactProcess] = []

    def start(**stream: Any) -> ContactProcess:
        arm = partial(NotingArm, notes=str(notes))
        source = partial(paced, **stream)
        made.append(ContactProcess(source, watching(stream), arm, CALM))
        return made[-1]

    yield start
    for process in made:
        process.close()


def wait(process: ContactProcess, *phases: str) -> dict[str, Any]:
    until_s = time.monotonic() + PATIENCE_S
    while (status := process.status()).get("phase") not in phases:
        assert time.monotonic() < until_s, status
        time.sleep(0.005)
    return status


def test_a_stream_that_stalls_stops_the_arm_in_the_stated_time(guard: Any, notes: Path) -> None:
    process = guard(stall=TOUCH)
    wait(process, "ready")
    until_s = time.monotonic() + PATIENCE_S
    while len(stops(notes)) < 2:
        last_s = process.status()["at_s"]
        assert time.monotonic() < until_s
        time.sleep(0.005)
    silent_s = stops(notes)[-1] - last_s
    assert silent_s < STALE_S + 0.002 + 0.02 + SLACK_S  # stale, the watch's period, the status' age
    assert process.alive()
    status = wait(process, "tripped")
    assert (status["health"], status["windows"] > 0) == ("stale", True)
    assert "no heartbeat" in status["reason"]


@pytest.mark.parametrize(("slow", "trips"), [((1, 1), False), ((20, NEVER), True)])
def test_windows_that_waited_before_the_watch_are_not_lag_and_later_ones_are(
    notes: Path, slow: tuple[int, int], trips: bool
) -> None:
    """The first question is the last thing before the watch; a guard tripped at once for 3.6 s."""
    config = partial(Watchdog, stale_s=60.0, backlog_s=SLOW_S / 2.0)
    arm = partial(SlowArm, notes=str(notes), slow=slow)
    with closing(ContactProcess(paced, watching({}), arm, config)) as process:
        status = wait(process, "ready", "tripped", "ended", "failed")
        assert status["phase"] == "ready", status
        if trips:
            wait_until(lambda: tripped(process))
        else:
            time.sleep(2.0 * SLOW_S)
        assert tripped(process) == trips, process.status()
        assert process.status()["health"] == ("overload" if trips else "ok")


def test_a_failure_is_told_however_long_its_text_is(notes: Path) -> None:
    arm = partial(NotingArm, notes=str(notes))
    with closing(ContactProcess(paced, long_failure, arm, CALM)) as process:
        status = wait(process, "failed")
    assert status["reason"].startswith("ValueError: \u00e9\u00e9\u00e9")
    assert status["reason"].endswith("(cut)")


def test_a_stream_that_breaks_stops_the_arm(guard: Any, notes: Path) -> None:
    status = wait(guard(fault=LATE_TOUCH), "ended", "failed")
    assert (status["phase"], status["health"]) == ("failed", "disconnected")
    assert status["reason"] == "OSError: the camera was unplugged"
    assert len(stops(notes)) == 2


@pytest.fixture
def begin(tmp_path: Path) -> Path:
    """File that lets happen what happens to a stream, once the arm moves."""
    return tmp_path / "begin"


@pytest.fixture
def moving(controller: URController, begin: Path) -> Iterator[Any]:
    """Return what starts a guard whose arm, behind the real driver, moves at 40 mm/s.

    The controller's own watchdog gives a busy machine a second, unless it is what is asked; the
    guard's gives it more than a test takes.
    """
    made: list[ContactProcess] = []

    def start(watchdog_hz: float = 1.0, **stream: Any) -> ContactProcess:
        arm = partial(moving_ur, controller.host, 40.0, watchdog_hz)
        source = partial(paced, begin=str(begin), **stream)
        status: dict[str, Any] = {}
        for _ in range(STARTS):
            made.append(ContactProcess(source, watching(stream), arm, PATIENT))
            status = wait(made[-1], "ready", "tripped", "ended", "failed")
            if status["phase"] == "ready":
                wait_until(lambda: controller.twin.speed_mm_s()[0] > 30.0 or tripped(made[-1]))
                if not tripped(made[-1]):
                    return made[-1]
                status = made[-1].status()
            made[-1].close()
            controller.recover()
        raise AssertionError(status)

    yield start
    for process in made:
        process.close()


def tripped(process: ContactProcess) -> bool:
    return process.status().get("phase") != "ready"


def still(controller: URController) -> bool:
    return bool(abs(controller.twin.speed_mm_s()[0]) <= REST_MM_S)


def test_a_contact_process_that_is_told_to_end_stops_the_arm(
    moving: Any, controller: URController
) -> None:
    process = moving()
    stops_before = len(controller.stop_times_s)
    controller.deaf_to = frozenset({WATCHDOG})  # it is not the robot that notices
    process.close()
    assert still(controller)
    assert len(controller.stop_times_s) > stops_before


def test_a_contact_process_that_hangs_is_stopped_and_ended(
    moving: Any, controller: URController, begin: Path
) -> None:
    process = moving(stall=0)
    controller.deaf_to = frozenset({WATCHDOG})
    begin.touch()
    time.sleep(0.1)  # long enough for it to hang; one that does not yet ends as well
    process.close()
    assert still(controller)
    assert not process.alive()


@pytest.mark.parametrize("stream", [{"touch": 0}, {"end": 0}])
def test_an_arm_that_ignores_the_stop_is_told(
    moving: Any, controller: URController, begin: Path, stream: dict[str, int]
) -> None:
    for _ in range(STARTS):
        process = moving(**stream)
        controller.deaf_to = EVERYTHING
        scripts = len(controller.scripts)
        begin.touch()
        status = wait(process, "ended", "failed")
        if "nothing is heard of the arm" not in status["stop_failure"]:
            break
        # The machine stalled, and the guard missed its controller: not what is asked here.
        controller.deaf_to = frozenset()
        process.close()
        begin.unlink()
        controller.recover()
    assert "the arm still moves at 40 mm/s" in status["stop_failure"]
    assert (status["contact"] is not None) == ("touch" in stream)
    assert status["health"] == ("not_stopped" if "touch" in stream else "disconnected")
    assert any("spikingtac_protect" in script for script in controller.scripts[scripts:])


def test_the_robot_stops_when_the_contact_process_dies(
    moving: Any, controller: URController
) -> None:
    process = moving(WATCHDOG_HZ)
    process.kill()
    assert wait_until(lambda: still(controller)) < 0.1 + 0.05 + SLACK_S


def test_a_lost_controller_is_told(moving: Any, controller: URController) -> None:
    process = moving()
    controller.shut_down()
    lost_s = time.monotonic()
    status = wait(process, "ended", "failed")
    assert status["health"] == "disconnected"
    assert status["at_s"] - lost_s < 0.1 + 0.02 + SLACK_S
