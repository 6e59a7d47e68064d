"""Files appear whole or not at all, whatever ends their writing."""

import errno
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from spikingtac.atomic_files import PARTIAL, WholeFile, require_free, whole_folder, write_text
from spikingtac.errors import ConfigError
from spikingtac.events import create_events
from spikingtac.types import EventPacket
from stand_ins.random_packets import random_packet, save_events

NAMES = ("a.raw", "a.npz", "a.csv", "a.aedat4", "a.h5")
SIZE = (320, 240)


def packet(n: int) -> EventPacket:
    return random_packet(1, n, SIZE)


def filled_disk(path: Path) -> None:
    """Write more than the disk takes."""
    save_events(path, *packet(160_000).split(80_000))


def listed(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("name", NAMES)
def test_an_error_leaves_what_was_there(tmp_path: Path, name: str) -> None:
    path = save_events(tmp_path / name, packet(100))
    before = path.read_bytes()
    with pytest.raises((AttributeError, TypeError)), create_events(path, SIZE) as writer:
        [writer.write(given) for given in (packet(5_000), None)]
    assert path.read_bytes() == before
    assert listed(tmp_path) == [name]


class FullDisk:
    """A file that takes some bytes and then says that the disk is full."""

    def __init__(self, file: Any, room: int) -> None:
        self._file, self._room = file, room

    def write(self, data: Any) -> int:
        self._room -= len(data)
        if self._room < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self._file.write(data)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


@pytest.mark.parametrize("name", sorted({*NAMES} - {"a.npz", "a.h5"}))
@pytest.mark.parametrize("room", [0, 20_000])
def test_a_full_disk_is_an_error_and_leaves_nothing(
    tmp_path: Path, name: str, room: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = WholeFile.open
    monkeypatch.setattr(
        WholeFile, "open", lambda self, *a, **k: FullDisk(opened(self, *a, **k), room)
    )
    (tmp_path / name).write_bytes(b"before")
    with pytest.raises(OSError, match="No space left"):
        filled_disk(tmp_path / name)
    assert (tmp_path / name).read_bytes() == b"before"
    assert listed(tmp_path) == [name]


def test_hdf5_is_not_written_where_the_disk_has_no_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.h5").write_bytes(b"before")
    room = shutil.disk_usage(tmp_path)._replace(free=20_000)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: room)
    with pytest.raises(OSError, match="No space left"):
        filled_disk(tmp_path / "a.h5")
    assert (tmp_path / "a.h5").read_bytes() == b"before"
    assert listed(tmp_path) == ["a.h5"]


def test_a_killed_process_leaves_no_file_and_the_next_one_cleans_up(tmp_path: Path) -> None:
    code = (
        "import sys, time; from spikingtac.atomic_files import WholeFile\n"
        "file = WholeFile(sys.argv[1]); f = file.open(); f.write(b'x' * 99); f.flush()\n"
        "print('begun', flush=True); time.sleep(60)"
    )
    path = tmp_path / "a[1].bin"
    child = subprocess.Popen(
        [sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE, text=True
    )
    assert child.stdout.readline() == "begun\n"
    child.send_signal(signal.SIGKILL)
    child.wait()
    child.stdout.close()
    assert not path.exists()
    assert len(listed(tmp_path)) == 1
    write_text(path, "whole")
    assert listed(tmp_path) == [path.name]
    (tmp_path / f".run{PARTIAL}{child.pid}.1").mkdir()
    with whole_folder(tmp_path / "run.1", last="b") as partial:
        (partial / "b").touch()
    assert listed(tmp_path) == [path.name, "run.1"]


def test_a_number_that_no_process_can_have_is_a_remainder_too(tmp_path: Path) -> None:
    (tmp_path / f".a{PARTIAL}{10**20}.txt").touch()
    write_text(tmp_path / "a.txt", "whole")
    assert listed(tmp_path) == ["a.txt"]


def test_a_folder_is_written_where_one_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run").mkdir()
    monkeypatch.chdir(tmp_path / "run")
    with whole_folder(".", last="b") as partial:
        (partial / "b").touch()
    assert listed(tmp_path / "run") == ["b"]


def test_replacing_must_be_asked_for(tmp_path: Path) -> None:
    assert require_free(tmp_path / "a.CSV", overwrite=False, endings=(".csv",)) == ".csv"
    (tmp_path / "a.csv").touch()
    with pytest.raises(ConfigError, match="--overwrite"):
        require_free(tmp_path / "a.csv", overwrite=False)
    require_free(tmp_path / "a.csv", overwrite=True)
    with pytest.raises(ConfigError, match="is a folder"):
        require_free(tmp_path, overwrite=True)
    for folder, why in (("b", "does not exist"), ("a.csv", "is a file")):
        with pytest.raises(ConfigError, match=why):
            require_free(tmp_path / folder / "a.csv", overwrite=True)
    with pytest.raises(OSError, match=r"'/proc/a.csv'"):  # no name of an unfinished file
        require_free("/proc/a.csv", overwrite=True)
    assert listed(tmp_path) == ["a.csv"]
