"""What is done: one line for each recording, written when it ends, read when a run is resumed."""

from __future__ import annotations

import json
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from spikingtac.batch.job import FileJob, Outcome

JOURNAL = "journal.jsonl"
"""Name of the file in the folder of a run."""


class Journal:
    """The outcomes of a run, in the order in which they came.

    A line that a crash cut is passed over: its recording is worked on again.

    Args:
        folder: The folder of the run.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / JOURNAL
        self._file: IO[str] | None = None

    def __enter__(self) -> Self:
        """Open it for more lines."""
        cut = self._path.is_file() and not self._path.read_bytes().endswith(b"\n")
        self._file = self._path.open("a", encoding="utf-8", newline="\n")
        self._file.write("\n" if cut else "")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close it."""
        assert self._file is not None  # __enter__() opened it
        self._file.close()

    def add(self, outcome: Outcome) -> None:
        """Write an outcome, so that it outlives this process."""
        assert self._file is not None  # __enter__() opened it
        self._file.write(outcome.text() + "\n")
        self._file.flush()

    def done(self, job: FileJob) -> Outcome | None:
        """Return the outcome of a job whose result is there, or None where it is to be done."""
        outcome = self._outcomes().get(job.key)
        if outcome is None or outcome.failed or outcome.output != job.output:
            return None
        output = Path(outcome.output)
        whole = output.is_file() and output.stat().st_size == outcome.output_bytes
        return outcome if whole else None

    def _outcomes(self) -> dict[str, Outcome]:
        if not hasattr(self, "_read"):
            self._read = {outcome.key: outcome for outcome in _parsed(self._path)}
        return self._read


def _parsed(path: Path) -> list[Outcome]:
    outcomes = []
    lines = path.read_text(encoding="utf-8", errors="replace").split("\n") if path.is_file() else []
    for line in lines:
        try:
            outcomes.append(Outcome(**json.loads(line)))
        except (ValueError, TypeError):
            continue
    return outcomes
