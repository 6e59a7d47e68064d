"""The verb ``touch --vibration`` from the command line."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spikingtac.cli.main import main
from spikingtac.cli.sensing.touch_watch import WatchArgs, track
from spikingtac.events.open import open_events
from spikingtac.events.windows import windows
from spikingtac.touch.vibration.rim_memory import BIN_US
from spikingtac.types import EventPacket


def buzzing(folder: Path) -> tuple[Path, Path]:
    """Write events of nine edges that shake at 80 Hz; return them and their calibration."""
    x, y = np.meshgrid(np.arange(3), np.arange(3))
    centers = 37.0 * np.column_stack([x.ravel(), y.ravel()]) + 30.0
    document = {"schema": 1, "size": [140, 140], "grid": [3, 3], "reference_px": centers.tolist(),
                "radius_px": [7.0] * 9, "px_per_mm": 15.0}  # fmt: skip
    calibration = folder / "c.json"
    calibration.write_text(json.dumps(document))
    t_us = np.arange(12_500, 2_112_500, BIN_US, dtype=np.int64)
    forth = np.cos(2e-6 * np.pi * 80.0 * t_us) > 0.0
    # The right edge of every marker: ON where it moves out, OFF where it comes back.
    marker = np.arange(len(t_us)) % 9
    columns = {"x": centers[marker, 0] + 7.0, "y": centers[marker, 1]}
    path = folder / "buzz.npz"
    np.savez(path, t=t_us, p=forth, size=np.array([140, 140]),
             **{name: place.astype(np.uint16) for name, place in columns.items()})  # fmt: skip
    return path, calibration


def test_vibration_is_told_from_events(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, calibration = buzzing(tmp_path)
    asked = ["touch", str(path), "--calibration", str(calibration)]
    assert main([*asked, "--vibration", "--json"]) == 0
    lines = json.loads(capsys.readouterr().out)["vibration"]
    assert [line["line_hz"] for line in lines] == pytest.approx([80.0] * 2, abs=0.2)
    assert lines[0]["amplitude_um"] is None  # a calibration by hand knows no contrast
    assert main([*asked, "--vibration"]) == 0
    assert "too few events" in capsys.readouterr().out
    assert main([*asked, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["vibration"] is None
    tracks = tmp_path / "a.npz"
    x, y = np.meshgrid(np.arange(3.0), np.arange(3.0))
    rests = np.column_stack([x.ravel(), y.ravel(), np.zeros(9)])
    np.savez(tracks, t_us=10_000 * np.arange(5), reference_mm=rests,
             displacement_mm=np.zeros((5, 9, 3)))  # fmt: skip
    assert main(["touch", str(tracks), "--vibration"]) == 2
    assert "measured from events" in capsys.readouterr().err


class Repacked:
    """A source of the same events in other packets."""

    def __init__(self, source: Any, length_us: int) -> None:
        self._source, self._length_us = source, length_us

    def __getattr__(self, name: str) -> Any:
        return getattr(self._source, name)

    def __iter__(self) -> Iterator[EventPacket]:
        return windows(self._source, self._length_us)


def test_the_verb_hears_the_same_vibration_in_any_packets(tmp_path: Path) -> None:
    path, calibration = buzzing(tmp_path)
    args = WatchArgs(calibration=calibration, vibration=True, preset="fast")
    found = []
    for length_us in (1_000, 33_000, 70_000, 10_000_000):
        watched = track(args, Repacked(open_events(path), length_us), calibration)
        for _ in watched.frames:
            pass
        found.append([(line.t_us, line.hz, line.ratio) for line in watched.lines or []])
    assert [t_us for t_us, _, _ in found[0]] == [1_012_500, 2_012_500]
    assert all(lines == found[0] for lines in found)
