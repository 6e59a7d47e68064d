"""Cameras behind makers' libraries: what is said where the library, or the camera, is missing."""

import sys
from importlib.resources import files
from importlib.util import find_spec

import pytest

from spikingtac.cameras import openmv
from spikingtac.errors import DeviceError, MissingExtraError
from spikingtac.events.camera import KINDS, Address, open_camera
from stand_ins.camera_counterparts import with_module
from stand_ins.camera_modules import hal_module
from stand_ins.openmv_board import OpenMvBoard

LIBRARIES = {name: kind for name, kind in KINDS.items() if kind.module}


@pytest.mark.parametrize("name", list(LIBRARIES))
def test_a_missing_library_names_what_brings_it(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    kind = LIBRARIES[name]
    for module in [item for item in sys.modules if item.partition(".")[0] == kind.module]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, kind.module, None)
    told = f"spikingtac\\[{kind.extra}\\]" if kind.extra else "build OpenEB"
    with pytest.raises(MissingExtraError, match=told):
        open_camera(Address.parse(kind.example))


@pytest.mark.parametrize("name", ["dv:", "nd:", "openmv:"])
def test_the_real_library_finds_no_camera_here(name: str) -> None:
    kind = KINDS[name.removesuffix(":")]
    if find_spec(kind.module) is None:
        pytest.skip(f"needs the extra [{kind.extra}]")
    with pytest.raises(DeviceError, match=r"plugged in|finds no"):
        open_camera(Address.parse(name))


def test_openeb_without_a_camera_says_so() -> None:
    with (
        with_module("metavision_hal", hal_module(None)),
        pytest.raises(DeviceError, match="finds no camera"),
    ):
        open_camera(Address.parse("prophesee:"))


def test_a_board_without_a_genx320_says_what_its_script_said() -> None:
    pytest.importorskip("openmv", reason="needs the extra [openmv]")
    board = OpenMvBoard(complaint="AttributeError: 'module' object has no attribute 'GENX320'")
    try:
        with pytest.raises(DeviceError, match=r"firmware 5\.0 or later.*GENX320"):
            open_camera(Address.parse(f"openmv:{board.port}"))
    finally:
        board.unplug()


def test_the_board_is_sent_our_script_with_the_transfer_asked_for() -> None:
    pytest.importorskip("openmv", reason="needs the extra [openmv]")
    board = OpenMvBoard()
    try:
        camera = open_camera(Address.parse(f"openmv:{board.port}?words=8192"))
        camera.close()
    finally:
        board.unplug()
    shipped = files("spikingtac.cameras").joinpath(openmv.SCRIPT).read_text(encoding="utf-8")
    assert board.script == shipped.replace("WORDS = 2048", "WORDS = 8192")
    compile(shipped, openmv.SCRIPT, "exec")
