"""Fixtures that every test may use."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from numba_cache import prepare_cache

# One test runs on each core: more threads make small products of matrices ten times as slow.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # begun in the background of a script
    signal.signal(signal.SIGINT, signal.default_int_handler)  # processes of tests are interrupted

PROJECT = Path(__file__).resolve().parents[1]

if "PYTEST_XDIST_WORKER" not in os.environ:  # the workers take over what the controller set
    chosen = os.environ.get("NUMBA_CACHE_DIR", PROJECT / ".numba_cache")
    os.environ["NUMBA_CACHE_DIR"] = str(prepare_cache(Path(chosen), PROJECT / "src" / "spikingtac"))


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Return the folder of test recordings, or skip where it is absent."""
    folder = Path(os.environ.get("SPIKINGTAC_DATA", PROJECT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"test recordings not found in {folder} (set SPIKINGTAC_DATA)")
    return folder


@pytest.fixture(scope="module", autouse=True)
def _nothing_left_open() -> Iterator[None]:
    """Collect garbage after each file of tests, so that what it left open fails there."""
    yield
    gc.collect()
