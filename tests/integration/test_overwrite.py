"""Verbs that write refuse to replace a file without --overwrite, all alike."""

from __future__ import annotations

import importlib
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.cli.main import main, module_of, verbs


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    t = np.arange(0, 20_000, 10)
    x = (t // 10 % 320).astype(np.uint16)
    np.savez(tmp_path / "in.npz", t=t, x=x, y=x[::-1], p=x > 9, size=(320, 320))
    return tmp_path / "in.npz"


def arguments(verb: str, recording: Path, output: Path) -> list[str]:
    if verb == "convert":
        return ["convert", str(recording), str(output)]
    if verb == "calibrate":
        return ["calibrate", str(recording), "-o", str(output)]
    calibration = output.with_name("calibration.json")
    centers = np.array([[100.0, 100.0], [200.0, 100.0]])
    if not calibration.exists():
        Calibration(
            reference_px=centers, radius_px=np.full(2, 8.0), grid=(1, 2), size=(320, 320)
        ).save(calibration)
    return ["track", str(recording), "--calibration", str(calibration), "-o", str(output)]


@pytest.mark.parametrize(
    ("verb", "name"), [("convert", "out.csv"), ("calibrate", "c.json"), ("track", "t.npz")]
)
def test_a_file_is_replaced_only_when_asked(
    recording: Path, tmp_path: Path, verb: str, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / name
    output.write_bytes(b"mine")
    given = arguments(verb, recording, output)
    assert main(given) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert output.read_bytes() == b"mine"
    code = main([*given, "--overwrite"])
    assert (code, output.read_bytes() == b"mine") == (
        (1, True) if verb == "calibrate" else (0, False)
    )
    assert not list(tmp_path.glob(".*"))


# Names of the arguments that say where something is written.
WRITTEN = {"output", "picture", "target", "export"}


def arguments_of(kind: object) -> list[type]:
    """Return the dataclasses of a verb's arguments, those of its subcommands included."""
    if is_dataclass(kind) and isinstance(kind, type):
        return [kind]
    return [found for part in get_args(kind) for found in arguments_of(part)]


def test_every_verb_that_writes_has_the_flag() -> None:
    writing, without = 0, []
    for verb in verbs():
        for kind in arguments_of(importlib.import_module(module_of(verb)).Args):
            names = {field.name for field in fields(kind)}
            writing += bool(names & WRITTEN)
            if names & WRITTEN and "overwrite" not in names:
                without.append(f"{verb}: {kind.__name__}")
    assert writing >= 13  # it looks at something
    assert without == []
