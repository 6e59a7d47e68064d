"""Jobs of a pool done in this process, as text all the same: for what is not about processes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from spikingtac.batch.job import FileJob, Outcome, run_text, text_of


def run_here(jobs: Iterable[FileJob], workers: int | None) -> Iterator[Outcome]:
    """Yield the outcome of every job, from where its worker would be called."""
    del workers
    for job in jobs:
        yield Outcome.parse(run_text(text_of(job)))
