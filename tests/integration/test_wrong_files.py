"""A file of the wrong kind, or one that may not be read: what it is, and what to do, is said."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.cli import main as frame
from spikingtac.cli.main import main
from stand_ins.tracks import circling_tracks
from stand_ins.viewer import record_circling


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording with its calibration, tracks, and a truth."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "circling").mkdir()
    record_circling(folder / "circling")
    circling_tracks(estimates=20).save(folder / "tracks.npz")
    np.savez(folder / "truth.npz", marker_t_us=np.arange(2), marker_px=np.zeros((2, 64, 2)))
    Calibration.load(folder / "circling" / "calibration.json").save(folder / "finger.json")
    return folder


def said(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    code = main([str(argument) for argument in arguments])
    shown = capsys.readouterr()
    return code, " ".join((shown.out + shown.err).split())


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("track", "tracks.npz", "--calibration", "finger.json"), "it holds tracks"),
        (("view", "finger.json"), "it is a calibration"),
        (("plot", "truth.npz"), "holds no tracks: it holds the truth"),
        (("track", "circling", "--calibration", "tracks.npz"), "no calibration: it holds tracks"),
        (("track", "circling", "--calibration", "circling/events.raw"), "make one with"),
        (("compare", "tracks.npz", "finger.json"), "neither tracks nor a truth: it is a calib"),
        (("compare", "tracks.npz", "nowhere.npz"), "No such file"),
    ],
)
def test_what_a_file_is_instead_is_told(
    words: tuple[str, ...], told: str, made: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(made)
    code, text = said(capsys, *words, *(("-o", "new.npz") if words[0] == "track" else ()))
    assert code == 1
    assert told in text


def test_tracks_and_their_truth_may_be_exchanged_by_mistake(
    made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, text = said(capsys, "compare", made / "truth.npz", made / "tracks.npz")
    assert code == 2
    assert f"compare {made / 'tracks.npz'} {made / 'truth.npz'}" in text


def test_figures_stand_with_their_units(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, text = said(capsys, "info", made / "circling")
    for unit in (" %", " us", "million events/s", "duration"):
        assert unit in text
    for key in ("on_fraction", "rate_mev", "rate ev s", "duration_s"):
        assert key not in text
    text = said(capsys, "info", made / "tracks.npz")[1]
    assert "never observed 9" in text
    assert "scale not known" in text


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--rate-hz", "fast"), "--rate-hz takes a number, 'fast' is none"),
        (("--workers=1.5",), "--workers takes a whole number, '1.5' is none"),
        (
            ("--polarity", "whites"),
            "--polarity cannot be 'whites'; did you mean 'white'? (valid: white",
        ),
    ],
)
def test_a_value_of_the_wrong_kind_is_told_in_words(
    words: tuple[str, ...], told: str, made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calibration = ("--calibration", made / "finger.json")
    code, text = said(capsys, "track", made / "circling", *calibration, *words)
    assert code == 2
    assert told in text
    assert "class" not in text


@pytest.mark.parametrize(
    ("number", "told"),
    [
        (errno.EACCES, "'x.raw': Permission denied; you may not read or write it"),
        (errno.ENOSPC, "'x.raw': No space left on device; free some space"),
    ],
)
def test_what_the_system_refuses_has_a_way_out(
    number: int, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    frame._report(OSError(number, os.strerror(number), "x.raw"), as_json=False)
    assert told in capsys.readouterr().err
