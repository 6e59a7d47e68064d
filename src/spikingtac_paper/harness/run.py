"""The run of an experiment or a bench: its options, its worker pool, its records on disk."""

import functools
import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from spikingtac.atomic_files import replacing, write_json
from spikingtac.batch import begin_run, worker_pool
from spikingtac.errors import named
from spikingtac.types import EventPacket

Advance = Callable[[float], None]  # Is called with the fraction of the work that is done, 0 to 1.

# A result as JSON holds it; ``key`` is the digest of everything that it depends on.
Record = dict[str, Any]
Job = TypeVar("Job")
Result = TypeVar("Result")

SOURCES = Path(__file__).resolve().parents[2]
PACKAGES = ("spikingtac", "spikingtac_paper")
CODE = (".py", ".toml", ".onnx", ".json")

# Packages whose versions every report states.
VERSIONED = ("numpy", "scipy", "numba", "onnxruntime", "opencv-python-headless", "trackpy")


@dataclass(frozen=True, kw_only=True, slots=True)
class RunOptions:
    """The options of a run.

    Attributes:
        output: Folder to write; empty, new, or with ``resume`` one of the same settings.
        quick: Use fewer seeds, so that the run takes some minutes.
        seed: First seed.
        seeds: Number of seeds; None takes the experiment's own number.
        resume: Continue a run that was interrupted.
        overwrite: Remove the run that is in the folder, and begin anew.
        workers: Number of processes; None takes one for each CPU.
        methods: Names of the methods to run; empty runs all.
        ablations: Run the ablations instead of the main tables, where there are any.
        data: Folder of recordings from elsewhere, or None.
        advance: Is called with the fraction that is done, 0 to 1.
    """

    output: Path
    quick: bool = False
    seed: int = 0
    seeds: int | None = None
    resume: bool = False
    overwrite: bool = False
    workers: int | None = None
    methods: tuple[str, ...] = ()
    ablations: bool = False
    data: Path | None = None
    advance: Advance | None = None

    def command(self, settings: Mapping[str, Any]) -> str:
        """Return the command line that repeats a run, as ``experiment holes -o out``."""
        verb = "bench" if "bench" in settings else "experiment"
        words = ["spikingtac", verb, settings[verb], f"-o {self.output.name}"]
        words += ["--quick"] if self.quick else []
        words += ["--ablations"] if self.ablations else []
        words += [f"--seed {self.seed}"] if self.seed else []
        words += [f"--seeds {self.seeds}"] if self.seeds else []
        words += [f"--methods {' '.join(self.methods)}"] if self.methods else []
        return " ".join(words)

    def begin(self, **settings: Any) -> dict[str, Any]:
        """Claim the folder for a run with these settings, and return them with ``quick``.

        Raises:
            ConfigError: The folder holds another run.
        """
        settings["quick"] = self.quick
        begin_run(self.output, settings, self.resume, self.overwrite)
        return settings

    def pool(self, tasks: int) -> AbstractContextManager[Executor]:
        """Return the worker pool of a run, to be entered.

        Args:
            tasks: Number of tasks: more processes would be idle.
        """
        return worker_pool.worker_pool(self.workers, tasks)

    def report_progress(self, done: int, total: int) -> None:
        """Call :attr:`advance`, if it is given, after ``done`` of ``total`` tasks."""
        if self.advance is not None:
            self.advance(done / total)


class Progress:
    """The progress of a run whose jobs are done in several steps.

    Args:
        options: Told after every job.
        total: Number of jobs of all steps.
    """

    def __init__(self, options: RunOptions, total: int) -> None:
        """Begin at nothing."""
        self._options, self._done, self._total = options, 0, total

    def run(
        self, pool: Executor, function: Callable[[Job], Result], jobs: Iterable[Job]
    ) -> list[Result]:
        """Return what a function returns for each job, in order; raise what one of them raises."""
        futures = [pool.submit(function, job) for job in jobs]
        for future in as_completed(futures):
            future.result()
            self._done += 1
            self._options.report_progress(self._done, self._total)
        return [future.result() for future in futures]


def kept(path: Path, key: str, make: Callable[[], Record]) -> Record:
    """Return the record of a file if it has this key; else make it, and write it."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        record = {}
    if record.get("key") != key:
        record = {"key": key, **make()}
        write_json(path, record)
    return record


def select_methods(known: Iterable[str], given: Sequence[str]) -> list[str]:
    """Return the given methods in the order of the known ones; all of these where none is given.

    Raises:
        ConfigError: A given method is unknown.
    """
    table: dict[str, Any] = dict.fromkeys(known)
    for name in given:
        named(table, name, "method")
    return [name for name in table if not given or name in given]


@functools.cache
def code_digest() -> str:
    """Return the sha256 (first 16 digits) of the product's and the experiments' sources.

    Stored results carry it: a run continues only with the code that began it.
    """
    total = hashlib.sha256()
    for package in PACKAGES:
        for file in sorted((SOURCES / package).rglob("*")):
            if file.suffix in CODE:
                total.update(str(file.relative_to(SOURCES)).encode())
                total.update(file.read_bytes())
    return total.hexdigest()[:16]


def provenance(options: RunOptions, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return how a report was made: command, settings, code, versions, machine."""
    from spikingtac._version import package_version

    installed = {one.name: one.version for one in metadata.distributions()}
    return {
        "command": options.command(settings),
        "settings": settings,
        "package_version": package_version(),
        "code_sha256": code_digest(),
        "git_commit": _commit(),
        "python": platform.python_version(),
        "versions": {name: installed[name] for name in VERSIONED if name in installed},
        "machine": platform.machine(),
        "system": platform.system(),
        "cpus": os.cpu_count(),
    }


def _commit() -> str | None:
    words = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        done = subprocess.run(words, cwd=SOURCES, capture_output=True, text=True, timeout=10)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() or None


def save_windows(path: Path, windows: Sequence[tuple[EventPacket, ...]]) -> None:
    """Write consecutive windows of one sensor."""
    packets = [window[0] for window in windows]
    x, y, p, t = (np.concatenate([getattr(one, name) for one in packets]) for name in "xypt")
    edges = np.array([packets[0].t_start_us, *(packet.t_end_us for packet in packets)])
    with replacing(path) as temporary:
        np.savez_compressed(temporary, edges=edges, size=packets[0].size, x=x, y=y, p=p, t=t)


def load_windows(path: Path) -> list[tuple[EventPacket, ...]]:
    """Read the windows that :func:`save_windows` wrote."""
    with np.load(path, allow_pickle=False) as file:
        x, y, p, t, edges = (file[name] for name in ("x", "y", "p", "t", "edges"))
        width, height = (int(side) for side in file["size"])
    whole = EventPacket(
        x=x, y=y, p=p, t=t, t_start_us=int(edges[0]), t_end_us=int(edges[-1]), size=(width, height)
    )
    cuts = np.searchsorted(t, edges)
    return [
        (whole.part(int(first), int(last), int(start), int(end)),)
        for first, last, start, end in zip(cuts, cuts[1:], edges, edges[1:], strict=False)
    ]
