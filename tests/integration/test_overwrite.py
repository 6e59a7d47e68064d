"""Verbs that write refuse to replace a file without --overwrite, all alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.cli.main import main


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


def test_a_simulation_is_replaced_only_when_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["simulate", "quiet", "-o", str(tmp_path / "s"), "--duration-s", "0.02"]
    assert main(given) == 0
    assert main(given) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main([*given, "--overwrite"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["s"]
