"""``cameras`` and ``doctor``: what is plugged in, what is missing, how a camera delivers."""

from __future__ import annotations

import json
import types
from types import SimpleNamespace
from typing import Any

import pytest

from spikingtac.cli.main import main
from spikingtac.events.camera import KINDS
from stand_ins.camera_counterparts import with_module


def drivers(devices: list[Any]) -> Any:
    module: Any = types.ModuleType("neuromorphic_drivers")
    module.__spec__ = SimpleNamespace(name="neuromorphic_drivers")
    module.list_devices = lambda: devices
    return module


def test_every_way_is_listed_with_what_is_missing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["cameras", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert list(told["kinds"]) == list(KINDS)
    assert told["kinds"]["udp"] == {
        "example": "udp:7777?encoding=evt2&size=320x320",
        "about": "EVT words in datagrams, as an STM32 board sends them",
        "library": None,
        "installed": True,
    }
    assert main(["cameras"]) == 0
    assert "udp:7777?encoding=evt2" in capsys.readouterr().out


def test_a_camera_is_listed_with_the_address_that_opens_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    device = SimpleNamespace(
        name=SimpleNamespace(value="Prophesee EVK4"), serial="00051505", error=None
    )
    with with_module("neuromorphic_drivers", drivers([device])):
        assert main(["cameras", "--json"]) == 0
    (camera,) = [
        item
        for item in json.loads(capsys.readouterr().out)["found"]
        if item["address"].startswith("nd:")
    ]
    assert camera["address"] == "nd:00051505"
    assert camera["model"] == "Prophesee EVK4"


def test_doctor_listens_to_a_camera(capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["doctor", "udp:127.0.0.1:0?encoding=evt3", "--seconds", "0.2", "--json"])
    assert code in (0, 3)
    checks = json.loads(capsys.readouterr().out)["checks"]
    (told,) = [item for item in checks if item["name"] == "delivery"]
    assert "nothing was delivered yet" in told["found"]
    assert main(["doctor", "upd:1", "--json"]) == 2
    assert main(["doctor", "udp:0", "--seconds", "0", "--json"]) == 2
