"""``spikingtac view`` and ``spikingtac demo`` without a browser, as on a server."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from spikingtac.cli.main import main
from stand_ins.viewer import record_circling

COMMAND = Path(sys.executable).with_name("spikingtac")
Done = subprocess.CompletedProcess[str]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_circling(tmp_path_factory.mktemp("recording"))


def spikingtac(*arguments: str) -> Done:
    return subprocess.run([COMMAND, *arguments], capture_output=True, text=True, timeout=300)


@pytest.fixture
def called(capsys: pytest.CaptureFixture[str]) -> Callable[..., Done]:
    """The same without a process of its own, for what is not about its start or its end."""

    def call(*arguments: str) -> Done:
        code = main(arguments)
        said = capsys.readouterr()
        return subprocess.CompletedProcess(arguments, code, said.out, said.err)

    return call


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Done]:
    """A demo of a second that wrote a picture, and what it said."""
    picture = tmp_path_factory.mktemp("demo") / "demo.png"
    words = "demo", "--headless", "--seconds", "1", "--port", "0", "-o", str(picture), "--json"
    return picture, spikingtac(*words)


def test_demo_headless_ends_by_itself_with_a_summary_and_a_picture(demo: tuple[Path, Done]) -> None:
    picture, done = demo
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["estimates"] > 10
    assert 0 < summary["error_mean_px"] < 2
    assert "open http" not in done.stderr  # no port is taken
    assert picture.read_bytes()[1:4] == b"PNG"


def test_view_of_a_folder_without_a_page_ends_where_it_ends(
    recording: Path, tmp_path: Path, called: Callable[..., Done]
) -> None:
    picture = tmp_path / "x.png"
    done = called("view", str(recording), "--headless", "-o", str(picture), "--json")
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["played_s"] == pytest.approx(0.6, abs=0.02)
    assert summary["calibration"] == str(recording / "calibration.json")
    assert summary["picture"] == str(picture)
    assert picture.read_bytes()[1:4] == b"PNG"


def test_events_alone_make_a_picture(
    recording: Path, tmp_path: Path, called: Callable[..., Done]
) -> None:
    (tmp_path / "events.raw").write_bytes((recording / "events.raw").read_bytes())
    for option in ("-o", "--export"):
        picture = tmp_path / f"x{option}.png"
        done = called("view", str(tmp_path), "--headless", option, str(picture), "--json")
        assert done.returncode == 0, done.stderr
        summary = json.loads(done.stdout)
        assert (summary["calibration"], summary.get("estimates", 0)) == (None, 0)
        assert picture.read_bytes()[1:4] == b"PNG"


def test_ctrl_c_ends_it_quietly(recording: Path) -> None:
    process = subprocess.Popen(
        [COMMAND, "view", str(recording), "--no-browser", "--port", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    assert process.stderr is not None
    line = process.stderr.readline()
    assert line.startswith("open http://127.0.0.1:")
    assert httpx.get(line.split()[1], timeout=60).status_code == 200
    process.send_signal(signal.SIGINT)
    out, rest = process.communicate(timeout=120)
    assert process.returncode == 0
    assert "estimates" in out
    assert "Traceback" not in rest


@pytest.mark.parametrize("wrong", [("--seconds", "0"), ("--seconds", "-1"), ("-o", "x.png")])
def test_an_export_of_nothing_or_with_a_picture_is_refused(
    wrong: tuple[str, str], recording: Path, tmp_path: Path, called: Callable[..., Done]
) -> None:
    done = called("view", str(recording), "--export", str(tmp_path / "x.gif"), *wrong)
    assert done.returncode == 2
    assert wrong[0] in done.stderr
    assert not (tmp_path / "x.gif").exists()
