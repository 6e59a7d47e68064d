"""What a new user types wrong, and what is said then."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from spikingtac.cli.main import main, verbs
from spikingtac.errors import RecordingError
from spikingtac.viewer.opening import open_view_source


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    code = main(arguments)
    shown = capsys.readouterr()
    assert "Traceback" not in shown.err
    return code, " ".join((shown.out + shown.err).split())


@pytest.fixture
def noise(tmp_path: Path) -> Path:
    path = tmp_path / "noise.raw"
    path.write_bytes(np.random.default_rng(0).bytes(30_000))
    return path


def test_a_wrong_option_is_named_even_where_an_argument_is_missing(
    capsys: pytest.CaptureFixture[str],
) -> None:
    code, text = said(capsys, "info", "--bogus", "x")
    assert code == 2
    assert "'--bogus'" in text
    assert "--strict" in text
    assert said(capsys, "info", "--stricd", "x")[1].count("did you mean '--strict'") == 1


@pytest.mark.parametrize("verb", verbs())
def test_help_shows_no_none(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, text = said(capsys, verb, "--help")
    assert code == 0
    assert "{None" not in text
    for nothing in ("(default: None)", "(default: False)", "(default: )"):
        assert nothing not in text.replace("│ │ ", "")
    assert "usage: spikingtac" in text


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("track", "a.raw"), "--calibration PATH"),
        (("view",), "SOURCE"),
        (("convert", "a", "b", "--crop", "1", "2"), "--crop"),
        (("plot", "a", "b"), "Unrecognized options: b"),
    ],
)
def test_what_the_parser_refuses_is_json_where_json_is_asked_for(
    words: tuple[str, ...], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words, "--json"]) == 2
    shown = capsys.readouterr()
    document = json.loads(shown.out)
    assert (document["exit_code"], document["kind"]) == (2, "ConfigError")
    assert told in document["error"]
    assert f"spikingtac {words[0]} --help" in document["error"]
    assert shown.err.startswith("spikingtac: error: ")


def test_what_is_no_recording_is_not_blamed_for_a_missing_calibration(
    tmp_path: Path, noise: Path
) -> None:
    (tmp_path / "words.txt").write_text("dear diary\n")
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "words.txt", tmp_path / "folder", noise):
        with pytest.raises(RecordingError) as refused:
            open_view_source(str(path))
        assert "calibration" not in str(refused.value)
