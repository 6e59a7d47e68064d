"""Fixtures that several files of integration tests use."""

from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager

import pytest


@contextmanager
def _one_thread(*_: object, **__: object) -> Iterator[Executor]:
    with ThreadPoolExecutor(1) as pool:
        yield pool


@pytest.fixture
def jobs_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do the work of a batch in this process, where nothing is said of the workers."""
    monkeypatch.setattr("spikingtac.batch.run.worker_pool", _one_thread)
