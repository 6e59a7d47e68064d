"""Fixtures that several files of integration tests use."""

from __future__ import annotations

import pytest

from stand_ins.jobs_here import run_here


@pytest.fixture
def jobs_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do the jobs of a pool in this process, where nothing is said of the workers."""
    monkeypatch.setattr("spikingtac.batch.processes.run_in_processes", run_here)
