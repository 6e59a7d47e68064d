"""A recording tracked in pieces by several workers: plan, track, compare seams, mend, join."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac._version import package_version
from spikingtac.batch.inputs import identity
from spikingtac.batch.job import FileJob, Outcome
from spikingtac.batch.journal import Journal
from spikingtac.batch.run_folder import begin_run
from spikingtac.errors import RecordingError, SpikingTacError
from spikingtac.pipeline.pieces.join import Stretch
from spikingtac.pipeline.pieces.piece import ends_of
from spikingtac.pipeline.pieces.plan import Piece, PlanPass
from spikingtac.pipeline.pieces.seams import Distance, distance
from spikingtac.tracks import Tracks

Runner = Callable[[Iterable[FileJob]], Iterator[Outcome]]
"""Yields the outcome of every job as they come: worker processes, or a cluster."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PieceWork:
    """What the workers do.

    Attributes:
        work: ``module:function`` of a piece, see :class:`spikingtac.batch.job.FileJob`.
        recording: The recording.
        folder: Where the pieces go until they are joined.
        settings: What every piece needs to know, as JSON holds it.
    """

    work: str
    recording: Path
    folder: Path
    settings: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True, slots=True)
class Pieced:
    """A recording that was tracked in pieces.

    Attributes:
        stretches: What to join.
        cuts_us: Where it was cut, us.
        seams: How far both ways were apart at each seam before any was mended.
        mended: Number of pieces that were tracked again from where the markers were.
        kept: Number of pieces that were there already.
        misfit: What the recording has against the calibration, or None.
    """

    stretches: Sequence[Stretch]
    cuts_us: Sequence[int]
    seams: Sequence[Distance]
    mended: int
    kept: int
    misfit: str | None


def track_pieces(
    work: PieceWork,
    plan: PlanPass,
    runner: Runner,
    resume: bool = False,
    advance: Callable[[float], None] = lambda share: None,
) -> Pieced:
    """Track every piece of a recording that is not done yet, and mend what the cuts spoiled.

    Args:
        work: What to do.
        plan: Where the recording is cut.
        runner: Who does it.
        resume: Keep the pieces that an interrupted run has left.
        advance: Told the share that is done.

    Raises:
        RecordingError: A piece failed; says why.
        ConfigError: The folder holds pieces of other settings, or of an interrupted run that is not
            to be resumed.
    """
    settings = {"version": package_version(), "recording": str(work.recording), **work.settings}
    new = begin_run(work.folder, settings, resume)
    with Journal(work.folder) as journal:
        run = _Run(work, plan, runner, journal)
        try:
            run.track(advance)
            mended = run.mend()
        except SpikingTacError:
            if new and not run.done:  # no worker was reached: nothing is to be resumed
                remove_pieces(work.folder)
            raise
    return Pieced(
        stretches=run.stretches(),
        cuts_us=run.cuts_us(),
        seams=run.seams,
        mended=mended,
        kept=run.kept,
        misfit=run.misfit,
    )


def remove_pieces(folder: Path) -> None:
    """Remove what is no longer needed once the tracks are written."""
    shutil.rmtree(folder)


class _Run:
    """The pieces of one recording and what became of each."""

    def __init__(self, work: PieceWork, plan: PlanPass, runner: Runner, journal: Journal) -> None:
        self._work, self._plan, self._runner, self._journal = work, plan, runner, journal
        self._files = identity(work.recording)
        self._pieces: list[Piece] = []
        self._outcomes: dict[str, Outcome] = {}
        self._agreed: dict[int, int | None] = {}
        self.seams: list[Distance] = []
        self.done = self.kept = 0
        self.misfit: str | None = None

    def track(self, advance: Callable[[float], None]) -> None:
        """Track every piece, each as soon as it is known."""
        for done, outcome in enumerate(self._run(self._jobs()), start=1):
            self.misfit = self.misfit or outcome.figures["calibration_misfit"]  # type: ignore[assignment]
            advance(done / len(self._pieces) * self._plan.progress)

    def mend(self) -> int:
        """Track pieces again whose seam shows that the skin did not rest; return how many.

        A piece is mended from where the one before ends, once that is known to be right.
        """
        later = range(1, len(self._pieces))
        self.seams = [self._seam(number) for number in later]
        spoiled = {number for number in later if not self.seams[number - 1].small}
        while spoiled:
            ready = [number for number in sorted(spoiled) if number - 1 not in spoiled]
            spoiled.difference_update(ready)
            for outcome in self._run(self._mending(number) for number in ready):
                number, agreed_us = outcome.figures["number"], outcome.figures["agreed_us"]
                assert isinstance(number, int)
                self._agreed[number] = None if agreed_us is None else int(agreed_us)
            for number in ready:
                after = number + 1
                if self._agreed[number] is None and after in later:
                    right = self._seam(after).small  # now that the one before is right
                    spoiled = spoiled - {after} if right else spoiled | {after}
        return len(self._agreed)

    def cuts_us(self) -> list[int]:
        """Return where the recording was cut, us."""
        return [piece.cut_us for piece in self._pieces[1:]]

    def stretches(self) -> list[Stretch]:
        """Return what to join."""
        found = []
        for piece in self._pieces:
            taken_us = piece.cut_us
            if piece.number in self._agreed:
                agreed_us = self._agreed[piece.number]
                until = piece.next_us if agreed_us is None else agreed_us
                found.append(Stretch(path=self._again(piece.number), from_us=taken_us, to_us=until))
                if agreed_us is None:
                    continue
                taken_us = agreed_us
            path = self._piece(piece.number)
            found.append(Stretch(path=path, from_us=taken_us, to_us=piece.next_us))
        return found

    def _run(self, jobs: Iterable[FileJob]) -> Iterator[Outcome]:
        """Yield what was kept and what the workers do; what is done is written down at once."""
        kept: list[Outcome] = []

        def open_jobs() -> Iterator[FileJob]:
            for job in jobs:
                outcome = self._journal.done(job)
                if outcome is None:
                    yield job
                else:
                    kept.append(outcome)

        for outcome in self._runner(open_jobs()):
            self._journal.add(outcome)
            if outcome.failed:
                raise RecordingError(f"a piece of {str(self._work.recording)!r}: {outcome.error}")
            self.done += 1
            yield outcome
        self.kept += len(kept)
        yield from kept

    def _jobs(self) -> Iterator[FileJob]:
        for piece in self._plan.pieces():
            self._pieces.append(piece)
            yield self._job(piece, self._piece(piece.number), {})

    def _mending(self, number: int) -> FileJob:
        """Return the job that begins where the piece before has the markers at the cut."""
        piece, before = self._pieces[number], Tracks.load(ends_of(self._best(number - 1)))
        row = int(before.t_us.searchsorted(piece.cut_us))
        start_px = before.detected_px[min(row, len(before.t_us) - 1)].astype(np.float64)
        begun = {"start_px": start_px.tolist(), "begun": str(self._piece(number))}
        return self._job(piece, self._again(number), begun)

    def _job(self, piece: Piece, output: Path, more: Mapping[str, Any]) -> FileJob:
        settings = {
            **self._work.settings,
            "piece": piece.document(),
            "origin_us": self._plan.first_us,
            **more,
        }
        source = str(self._work.recording)
        depends = (self._work.work, source, self._files, str(output), settings, package_version())
        key = hashlib.sha256(json.dumps(depends, sort_keys=True).encode()).hexdigest()
        return FileJob(
            work=self._work.work, source=source, output=str(output), settings=settings, key=key
        )

    def _seam(self, number: int) -> Distance:
        """Return how far a piece and the one before are apart where both go on."""
        before = Tracks.load(ends_of(self._best(number - 1)))
        return distance(before, Tracks.load(ends_of(self._piece(number))))

    def _best(self, number: int) -> Path:
        """Return the file in which a piece's end is right."""
        mended = number in self._agreed and self._agreed[number] is None
        return self._again(number) if mended else self._piece(number)

    def _piece(self, number: int) -> Path:
        return self._work.folder.absolute() / f"{number:05}.npz"

    def _again(self, number: int) -> Path:
        return self._work.folder.absolute() / f"{number:05}-mended.npz"
