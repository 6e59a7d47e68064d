"""Worker processes on this machine: one recording each at a time; a worker that dies is replaced.

Not ``concurrent.futures``: there, one killed worker breaks the whole pool, and nobody knows which
task it had. Here every worker has a pipe of its own, so that its end tells which recording it was.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext

from spikingtac.batch.job import FileJob, Outcome, run_text, text_of
from spikingtac.batch.worker_pool import SINGLE_THREAD, cpu_count, end_with_parent

ATTEMPTS = 2
"""Deaths of a worker after which its recording counts as failed: one may be the machine's."""
PATIENCE_S = 5.0
"""Time for an idle worker to end by itself."""


def run_in_processes(jobs: Iterable[FileJob], workers: int | None) -> Iterator[Outcome]:
    """Yield the outcome of every job, as they come.

    When the iteration is given up, the workers are killed: outputs are whole or not there.

    Args:
        jobs: The jobs, in the order in which they are begun; while an iterator still finds more,
            the first ones are worked on.
        workers: Number of processes; None takes one for every CPU, and there are never more.
    """
    for name in SINGLE_THREAD:
        os.environ.setdefault(name, "1")
    waiting, deaths = _Waiting(jobs), Counter[str]()
    most = len(jobs) if isinstance(jobs, Sequence) else cpu_count()
    pool = [_Worker() for _ in range(max(1, min(workers or cpu_count(), cpu_count(), most)))]
    try:
        while waiting or any(worker.job for worker in pool):
            for worker in pool:
                if worker.job is None and waiting:
                    worker.begin(waiting.pop())
            for worker in _ready(pool, 0.0 if waiting.look_ahead() else None):
                job, outcome = worker.end()
                if outcome is None:
                    deaths[job.key] += 1
                    if deaths[job.key] < ATTEMPTS:
                        waiting.put_back(job)
                        continue
                    outcome = _given_up(job)
                yield outcome
        for worker in pool:
            worker.dismiss()
    finally:
        for worker in pool:
            worker.kill()


class _Waiting:
    """Jobs that wait for a worker, some of them not found yet."""

    def __init__(self, jobs: Iterable[FileJob]) -> None:
        self._more = iter(jobs)
        self._found: deque[FileJob] = deque()
        self.look_ahead()

    def __bool__(self) -> bool:
        return bool(self._found)

    def look_ahead(self) -> bool:
        """Find one more; False where there is none."""
        job = next(self._more, None)
        if job is not None:
            self._found.append(job)
        return job is not None

    def pop(self) -> FileJob:
        return self._found.popleft()

    def put_back(self, job: FileJob) -> None:
        self._found.append(job)


def _ready(pool: Sequence[_Worker], timeout_s: float | None) -> list[_Worker]:
    ready = wait([worker.pipe for worker in pool if worker.job], timeout_s)
    return [worker for worker in pool if worker.pipe in ready]


def _given_up(job: FileJob) -> Outcome:
    text = (
        f"the worker process ended {ATTEMPTS} times while it had this recording, killed or out of "
        "memory; try it alone, or with fewer workers"
    )
    return Outcome.failure(job, text, "WorkerLost")


class _Worker:
    """A process and what it has in hand."""

    def __init__(self) -> None:
        self.job: FileJob | None = None
        self._start()

    def _start(self) -> None:
        # Fresh interpreters: a fork would copy locks whose threads it does not copy.
        context: SpawnContext = multiprocessing.get_context("spawn")
        self.pipe, end = context.Pipe()
        self.process = context.Process(target=_serve, args=(end,), daemon=True)
        with _interrupts_held():
            self.process.start()
        end.close()  # the worker's end: its death shall close the pipe

    def begin(self, job: FileJob) -> None:
        """Give it a job; one that died while it was idle is replaced first."""
        try:
            self.pipe.send_bytes(text_of(job).encode())
        except OSError:
            self._replace()
            self.pipe.send_bytes(text_of(job).encode())
        self.job = job

    def end(self) -> tuple[FileJob, Outcome | None]:
        """Return its job and outcome, or None where the process died."""
        job, self.job = self.job, None
        assert job is not None  # only workers with a job are waited for
        try:
            return job, Outcome.parse(self.pipe.recv_bytes())
        except (EOFError, OSError):
            self._replace()
            return job, None

    def _replace(self) -> None:
        self.kill()
        self._start()

    def dismiss(self) -> None:
        """Let an idle process end."""
        self.pipe.close()
        self.process.join(PATIENCE_S)

    def kill(self) -> None:
        """End the process at once."""
        self.pipe.close()
        if self.process.is_alive():
            self.process.kill()
        self.process.join()


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Keep Ctrl-C from the process that is started here: its parent alone decides what ends."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(pipe: Connection) -> None:
    end_with_parent()
    while True:
        try:
            text = pipe.recv_bytes()
        except (EOFError, OSError):
            return
        pipe.send_bytes(run_text(text.decode()).encode())
