"""The frame of the command line, through the installed command."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from spikingtac.cli import main as frame
from spikingtac.cli.main import verbs
from spikingtac.errors import ConfigError, MissingExtraError, RecordingError

COMMAND = Path(sys.executable).with_name("spikingtac")


def spikingtac(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [COMMAND, *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, **environment},
    )


def test_help_lists_every_verb() -> None:
    done = spikingtac("--help")
    assert done.returncode == 0
    assert all(f"\n  {verb} " in done.stdout for verb in verbs())


def test_a_mistyped_verb_gets_a_suggestion() -> None:
    done = spikingtac("calibrat")
    assert done.returncode == 2
    assert "did you mean 'calibrate'" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_reader_that_leaves_ends_the_command_quietly() -> None:
    with subprocess.Popen(
        [COMMAND, "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        noise = process.stderr.read()
    assert process.returncode == frame.EXIT_BROKEN_PIPE
    assert noise == b""


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (RecordingError("cut"), 1),
        (ConfigError("unknown"), 2),
        (MissingExtraError("none"), 3),
        (FileNotFoundError(2, "No such file", "x.raw"), 1),
        (OSError(28, "No space left on device"), 3),
        (ZeroDivisionError("a mistake of ours"), 3),
    ],
)
def test_errors_become_exit_codes(
    error: Exception, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(arguments: list[str]) -> int:
        raise error

    monkeypatch.setattr(frame, "_dispatch", fail)
    assert frame.main(["info", "--json"]) == code
    captured = capsys.readouterr()
    assert json.loads(captured.out)["exit_code"] == code
    assert captured.err.startswith("spikingtac: error: ")
    assert "Traceback" not in captured.err


def test_debug_shows_the_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(arguments: list[str]) -> int:
        raise RecordingError(f"cut {arguments}")

    monkeypatch.setattr(frame, "_dispatch", fail)
    assert frame.main(["info", "--debug"]) == 1
    captured = capsys.readouterr()
    assert "Traceback" in captured.err
    assert "cut ['info']" in captured.err


def test_ctrl_c_is_quiet(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(arguments: list[str]) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(frame, "_dispatch", interrupt)
    assert frame.main(["info"]) == frame.EXIT_INTERRUPTED
    assert capsys.readouterr().err == ""
