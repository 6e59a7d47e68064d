"""Standard input goes through a pipe as it is, and nothing is left of the pipe."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import RecordingError
from spikingtac.live.standard_input import standard_input_pipe


class Given:
    """A standard input that is a descriptor."""

    def __init__(self, number: int, *, terminal: bool = False) -> None:
        self._number, self._terminal = number, terminal

    def fileno(self) -> int:
        return self._number

    def isatty(self) -> bool:
        return self._terminal


def test_all_bytes_pass(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = np.random.default_rng(0).bytes(300_000)
    (tmp_path / "data").write_bytes(data)
    number = os.open(tmp_path / "data", os.O_RDONLY)
    monkeypatch.setattr(sys, "stdin", Given(number))
    with standard_input_pipe() as pipe:
        assert pipe.read_bytes() == data
    assert not pipe.parent.exists()
    os.close(number)


def test_a_terminal_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", Given(0, terminal=True))
    with pytest.raises(RecordingError, match="terminal"), standard_input_pipe():
        pass
