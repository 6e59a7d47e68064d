"""Many recordings through the command line: equal to one by one, resumed, and never stopped."""

import csv
import hashlib
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spikingtac.cli.main import main
from spikingtac.events import open_events
from spikingtac.types import EventPacket
from stand_ins.random_packets import save_events
from stand_ins.small_twin import calibration, touches
from stand_ins.verbs import Verbs
from stand_ins.waiting import wait_until

COUNT = 4
PART_US = 300_000


@pytest.fixture(scope="module")
def day(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four parts of a simulated recording, a file that is none, and a calibration."""
    folder = tmp_path_factory.mktemp("day")
    (folder / "recordings").mkdir()
    whole = EventPacket.concatenate(list(touches().packets))
    for number in range(COUNT):
        first_us = whole.t_start_us + number * PART_US
        inside = (whole.t >= first_us) & (whole.t < first_us + PART_US)
        save_events(folder / "recordings" / f"{number}.raw", whole.select(inside))
    (folder / "recordings" / "bad.raw").write_bytes(b"junk")
    calibration().save(folder / "calibration.json")
    return folder


def digests(folder: Path) -> dict[str, str]:
    files = sorted(folder.glob("[0-9].*"))
    return {file.stem: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


@pytest.fixture(scope="module")
def one_by_one(day: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("one")
    for number in range(COUNT):
        arguments = [str(day / "recordings" / f"{number}.raw"), "-o", str(folder / f"{number}.npz")]
        assert main(["track", *arguments, "--calibration", str(day / "calibration.json")]) == 0
    return digests(folder)


def track(day: Path, output: Path, *options: object) -> list[object]:
    given = ["--calibration", day / "calibration.json", "-o", output, *options]
    return ["track", day / "recordings", *given]


def test_many_are_tracked_as_each_would_be(
    day: Path, one_by_one: dict[str, str], tmp_path: Path, verbs: Verbs, request: Any
) -> None:
    given = track(day, tmp_path / "out", "--workers", 1)
    found = verbs.told(*given, code=1)  # one failed
    assert (found["recordings"], found["done"], found["failed"]) == (COUNT + 1, COUNT, 1)
    assert Path(found["rows"][0]["source"]).name == "bad.raw"
    assert "names no encoding" in found["rows"][0]["error"]
    assert {row["estimates"] for row in found["rows"][1:]} == {300}
    assert Path(found["table"]).is_file()
    assert digests(tmp_path / "out") == one_by_one
    assert not list((tmp_path / "out").glob(".*"))
    request.getfixturevalue("jobs_here")
    assert verbs.told(*given, "--resume", code=1)["kept"] == COUNT


@pytest.mark.usefixtures("jobs_here")
def test_touches_of_many_tracks_and_events_of_many_files(
    day: Path, tmp_path: Path, verbs: Verbs
) -> None:
    recordings = day / "recordings" / "[01].raw"
    given = ["--calibration", day / "calibration.json", "--workers", 1]
    said = verbs.said("touch", recordings, "-o", tmp_path / "touches", *given)
    assert "2 of 2 recordings done" in said
    with (tmp_path / "touches" / "1.csv").open(newline="") as file:
        assert "begin_us" in next(csv.reader(file))
    options = ["-o", tmp_path / "npz", "--to", "npz", "--workers", 1]
    found = verbs.told("convert", recordings, *options)["rows"]
    from_zero = verbs.said("convert", recordings, *options, "--from-us", 0, "--resume", code=2)
    assert "from_us None -> 0" in from_zero
    rows = {Path(row["source"]).stem: row for row in found}
    for name in "01":
        before = EventPacket.concatenate(list(open_events(day / "recordings" / f"{name}.raw")))
        after = EventPacket.concatenate(list(open_events(tmp_path / "npz" / f"{name}.npz")))
        np.testing.assert_array_equal(after.t, before.t)
        assert rows[name]["events"] == len(before)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.usefixtures("jobs_here")  # of what goes on: the interrupted run is a program
def test_an_interrupted_run_goes_on_where_it_was(
    day: Path, one_by_one: dict[str, str], tmp_path: Path, verbs: Verbs
) -> None:
    pipe = day / "recordings" / "pipe.raw"
    os.mkfifo(pipe)  # a recording that never comes: the run cannot end by itself
    given = track(day, tmp_path / "out", "--workers", 1)
    given[1:2] = [day / "recordings" / "0.raw", day / "recordings" / "1.raw", pipe]
    command = [sys.executable, "-m", "spikingtac", *map(str, given)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    journal = tmp_path / "out" / "journal.jsonl"
    wait_until(lambda: journal.is_file() and journal.read_bytes().count(b"\n") == 2)
    process.send_signal(signal.SIGINT)
    error = process.communicate(timeout=60)[1].decode()
    pipe.unlink()
    assert process.returncode == 130
    assert "--resume" in error
    assert "Traceback" not in error
    given[3] = day / "recordings" / "2.raw"
    assert verbs.told(*given, "--resume")["kept"] == 2
    assert digests(tmp_path / "out") == {name: one_by_one[name] for name in "012"}


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["track", "a.raw", "b.raw", "--calibration", "c.json"], "-o results"),
        (["track", "a.raw", "b.raw", "--calibration", "c.json", "-o", "x.npz"], "-o results"),
        (["track", "--calibration", "c.json"], "name a recording"),
        (["convert", "a.raw"], "-o FOLDER --to npz"),
        (["convert", "a.raw", "b.raw", "-o", "x"], "--to npz"),
        (["convert", "a.raw", "b.raw", "-o", "x", "--to", "nzp"], "did you mean"),
        (["convert", "a.raw", "-o", "x", "--to", "npz", "--encoding", "evt2"], ".raw files"),
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_is_written(
    arguments: list[str], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verbs: Verbs
) -> None:
    monkeypatch.chdir(tmp_path)
    assert told in verbs.said(*arguments, code=2)
    assert not list(tmp_path.iterdir())
