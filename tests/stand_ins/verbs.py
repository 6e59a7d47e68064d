"""The command line, called in this process."""

import json
from dataclasses import dataclass
from typing import Any

import pytest

from spikingtac.cli.main import main


@dataclass
class Verbs:
    """Runs verbs that have to end with an exit code; words may be paths and numbers."""

    capsys: pytest.CaptureFixture[str]
    err: str = ""  # What the last one said on standard error.

    def said(self, *words: object, code: int = 0) -> str:
        """Return what a verb says, on both outputs."""
        return self._run(words, code) + self.err

    def told(self, *words: object, code: int = 0) -> dict[str, Any]:
        """Return the document of a verb, asked for with ``--json``."""
        return json.loads(self._run((*words, "--json"), code))

    def _run(self, words: tuple[object, ...], code: int) -> str:
        self.capsys.readouterr()
        assert main([str(word) for word in words]) == code
        out, self.err = self.capsys.readouterr()
        assert "Traceback" not in self.err
        return out
