"""Cameras on the command line: what is listed, how a verb ends, deadlines, two fingers."""

import contextlib
import json
import os
import signal
import threading
import types
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from spikingtac.cli.main import main
from spikingtac.cli.options import JsonArgs
from spikingtac.cli.sources import EXIT_TERMINATED, for_each
from spikingtac.errors import ConfigError
from spikingtac.events.camera import KINDS
from stand_ins.camera_counterparts import with_module
from stand_ins.verbs import Verbs

PATIENCE_S = 20.0


def test_every_way_is_listed_with_what_is_missing_and_what_is_plugged_in(verbs: Verbs) -> None:
    drivers: Any = types.ModuleType("neuromorphic_drivers")
    drivers.__spec__ = SimpleNamespace(name="neuromorphic_drivers")
    name = SimpleNamespace(value="Prophesee EVK4")
    drivers.list_devices = lambda: [SimpleNamespace(name=name, serial="00051505", error=None)]
    with with_module("neuromorphic_drivers", drivers):
        told = verbs.told("cameras")
    assert list(told["kinds"]) == list(KINDS)
    assert told["kinds"]["udp"] == {
        "example": "udp:7777?encoding=evt2&size=320x320",
        "about": "EVT words in datagrams, as an STM32 board sends them",
        "library": None,
        "installed": True,
    }
    (camera,) = [item for item in told["found"] if item["address"].startswith("nd:")]
    assert (camera["address"], camera["model"]) == ("nd:00051505", "Prophesee EVK4")
    assert "udp:7777?encoding=evt2" in verbs.said("cameras")


def test_doctor_listens_to_a_camera(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "udp:127.0.0.1:0?encoding=evt3", "--seconds", "0.2", "--json"]) in (0, 3)
    checks = json.loads(capsys.readouterr().out)["checks"]
    (told,) = [item for item in checks if item["name"] == "delivery"]
    assert "nothing was delivered yet" in told["found"]
    assert {"python", "libraries", "kernel cache"} <= {item["name"] for item in checks}
    assert main(["doctor", "upd:1", "--json"]) == 2


@pytest.mark.parametrize("verb", ["track", "contact", "view"])
def test_a_recording_has_no_deadlines(verb: str, tmp_path: Path, verbs: Verbs) -> None:
    (tmp_path / "short.raw").touch()
    given = [verb, tmp_path / "short.raw", "--calibration", "finger.json", "--realtime"]
    assert "is a recording and has no deadlines" in verbs.said(*given, code=2)
    told = verbs.said("view", "udp:7777", "--realtime", "--export", "a.mp4", code=2)
    assert "--realtime is for the page" in told


def test_sigterm_closes_what_any_verb_has_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    former, closed = signal.getsignal(signal.SIGTERM), []

    def told_to_end(_: JsonArgs) -> None:
        with contextlib.ExitStack() as stack:
            stack.callback(lambda: closed.append("arm"))
            os.kill(os.getpid(), signal.SIGTERM)
            threading.Event().wait(10.0)

    monkeypatch.setattr("spikingtac.cli.main.function_of", lambda _: (told_to_end, JsonArgs))
    assert main(["convert"]) == EXIT_TERMINATED
    assert closed == ["arm"]
    assert signal.getsignal(signal.SIGTERM) is former


class Live:
    """A source that can be closed, as a camera's."""

    closed = False

    def close(self) -> None:
        self.closed = True


def test_cameras_are_read_at_once_and_recordings_one_by_one() -> None:
    both_run = threading.Barrier(2)
    cameras: list[Any] = [Live(), Live()]
    ranks = for_each(lambda number, source: both_run.wait(PATIENCE_S) >= 0 and number, cameras)
    assert ranks == [0, 1]
    order: list[int] = []
    recordings: list[Any] = [object(), object()]
    assert for_each(lambda number, source: order.append(number) or number, recordings) == [0, 1]
    assert order == [0, 1]


@pytest.mark.parametrize("failing", [0, 1])
def test_where_one_camera_fails_the_other_one_is_closed(failing: int) -> None:
    cameras: list[Any] = [Live(), Live()]

    def work(number: int, source: Any) -> None:
        if number == failing:
            raise ConfigError("it does not fit")
        while not source.closed:
            threading.Event().wait(0.01)

    with pytest.raises(ConfigError, match="does not fit"):
        for_each(work, cameras)
    assert cameras[1 - failing].closed
