"""The ten tasks of a new user, as the documentation's front page gives them."""

import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

from spikingtac.cli.main import _parsed, function_of, main
from spikingtac.sim.catalog import load_scene
from spikingtac.sim.render import simulate
from stand_ins.known import known
from stand_ins.pasted import SHOWN

PAGE = Path(__file__).resolve().parents[2] / "docs" / "README.md"
MOST_COMMANDS = 3
PYTHON = "st."

# Run elsewhere: calibration and forces take minutes (tutorial, touch verbs); cameras, and what one
# records, are no part of a test; the guard has a test of its own.
ELSEWHERE = {"calibrate", "cameras", "force", "guard", "record", "day"}
LIVE = "st.live"  # Its page is run by test_docs.


def tasks() -> dict[str, list[str]]:
    """Return task -> its commands and lines of Python."""
    items = PAGE.read_text(encoding="utf-8").split("## Ten tasks")[1].split("\n## ")[0]
    rows = re.findall(r"^- ([^:]+): (.+)$", items, re.M)
    return {task: re.findall(r"`((?:spikingtac |st\.)[^`]+)`", text) for task, text in rows}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short recording, and a calibration of its sensor."""
    where = tmp_path_factory.mktemp("tasks")
    simulate(load_scene("finger-presses"), where / "made", seed=1, duration_s=0.8)
    shutil.copy(where / "made" / "events.raw", where / "press.raw")
    with np.load(where / "made" / "truth.npz") as truth:
        known(truth["reference_px"], truth["radius_px"], step=0.14).save(where / "finger.json")
    assert main(["track", str(where / "press.raw"), "--calibration", str(where / "finger.json"),
                 "-o", str(where / "press.npz")]) == 0  # fmt: skip
    return where


def test_there_are_ten_and_none_takes_many_commands() -> None:
    found = tasks()
    assert len(found) == 10
    assert {task: len(commands) for task, commands in found.items() if not commands} == {}
    assert max(map(len, found.values())) <= MOST_COMMANDS


@pytest.fixture(scope="module")
def shown() -> set[str]:
    """Commands that showed a page; one that two tasks have is run once."""
    return set()


@pytest.mark.parametrize("task", tasks())
def test_a_task_is_done_by_its_commands(
    task: str, folder: Path, shown: set[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("press.raw", "finger.json", "press.npz"):
        shutil.copy(folder / name, tmp_path / name)
    if any("-o press.npz" in command for command in tasks()[task]):
        (tmp_path / "press.npz").unlink()
    monkeypatch.chdir(tmp_path)
    for command in tasks()[task]:
        if command.startswith(LIVE):
            continue
        if command.startswith(PYTHON):
            pytest.importorskip("pandas", reason="the extra [tables] is not installed")
            exec(f"import spikingtac as st\nfound = {command}\nassert len(found)", {})
            continue
        _, verb, *rest = shlex.split(command)
        assert _parsed(function_of(verb)[1], verb, rest) is not None
        if not ELSEWHERE.isdisjoint([verb, *rest]) or command in shown:
            continue
        if verb in SHOWN and "--export" not in rest:
            shown.add(command)
            rest += ["--headless", "--seconds", "1", "--port", "0"]
        assert main([verb, *rest]) == 0, command
