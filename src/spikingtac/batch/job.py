"""One recording to work on, and what became of it; both travel as JSON."""

from __future__ import annotations

import importlib
import json
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

from spikingtac._version import package_version
from spikingtac.errors import ConfigError, SpikingTacError

Figure = str | int | float | None
"""One cell of the table of all results."""

OWN = "spikingtac."
"""Work is found in this package only."""


@dataclass(frozen=True, kw_only=True, slots=True)
class FileJob:
    """The work on one recording.

    Attributes:
        work: ``module:function``; called with settings, recording and output, it writes the output
            and returns figures by name.
        source: The recording.
        output: The file to write.
        settings: What the function needs to know, as JSON holds it.
        key: Digest of all that the result depends on.
        version: The package that asks; another one's results are not mixed with its own.
    """

    work: str
    source: str
    output: str
    settings: Mapping[str, Any]
    key: str
    version: str = field(default_factory=package_version)


@dataclass(frozen=True, kw_only=True, slots=True)
class Outcome:
    """What became of a job.

    Attributes:
        key: The job's.
        source: The recording.
        output: The file that was written, or would have been.
        seconds: Time that it took, s.
        figures: What was found, by name; empty where it failed.
        output_bytes: Size of the file that was written.
        error: Why it failed, None where it did not.
        kind: Class of the error.
    """

    key: str
    source: str
    output: str
    seconds: float
    figures: dict[str, Figure] = field(default_factory=dict)
    output_bytes: int = 0
    error: str | None = None
    kind: str | None = None

    @property
    def failed(self) -> bool:
        """Whether there is an error instead of a result."""
        return self.error is not None

    @classmethod
    def failure(cls, job: FileJob, error: str, kind: str, seconds: float = 0.0) -> Self:
        """Return the outcome of a job that failed."""
        return cls(
            key=job.key,
            source=job.source,
            output=job.output,
            seconds=seconds,
            error=error,
            kind=kind,
        )

    @classmethod
    def parse(cls, text: str | bytes) -> Self:
        """Return the outcome that :meth:`text` wrote."""
        return cls(**json.loads(text))

    def text(self) -> str:
        """Return the outcome as JSON on one line."""
        return json.dumps(asdict(self), allow_nan=False)


def text_of(job: FileJob) -> str:
    """Return a job as JSON."""
    return json.dumps(asdict(job), allow_nan=False)


def run_text(text: str) -> str:
    """Do the job of a text and return the text of its outcome: what every kind of worker calls."""
    return run_job(FileJob(**json.loads(text))).text()


def run_job(job: FileJob) -> Outcome:
    """Do a job. It never raises: whatever goes wrong with one recording is its outcome."""
    begun = time.perf_counter()
    try:
        output = Path(job.output)
        output.parent.mkdir(parents=True, exist_ok=True)
        figures = _function(job)(job.settings, Path(job.source), output)
        size = output.stat().st_size
    except Exception as error:
        known = isinstance(error, SpikingTacError | OSError)
        text = str(error) if known else f"internal error, {type(error).__name__}: {error}"
        seconds = time.perf_counter() - begun
        return Outcome.failure(job, text, type(error).__name__, seconds)
    return Outcome(
        key=job.key,
        source=job.source,
        output=job.output,
        seconds=time.perf_counter() - begun,
        figures=dict(figures),
        output_bytes=size,
    )


def require_version(version: str) -> None:
    """Refuse work of another version of this package.

    Raises:
        ConfigError: It is of another one.
    """
    if version != package_version():
        raise ConfigError(
            f"this worker runs spikingtac {package_version()}, the work is of {version}; "
            "install the same version on every machine"
        )


def _function(job: FileJob) -> Any:
    require_version(job.version)
    module, _, name = job.work.partition(":")
    if not module.startswith(OWN):
        raise ConfigError(f"{job.work!r} is no work of this package")
    return getattr(importlib.import_module(module), name)
