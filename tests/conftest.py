"""Fixtures that every test may use."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Generator, Iterator
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


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Set aside what is imported, so that no collection of garbage visits it again."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.collect()
        gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def _nothing_left_open_at_the_end() -> Iterator[None]:
    """Collect what outlived its file and was dropped later."""
    yield
    gc.unfreeze()
    gc.collect()


@pytest.fixture(scope="module", autouse=True)
def _nothing_left_open(_nothing_left_open_at_the_end: None) -> Iterator[None]:
    """Collect garbage after each file of tests, so that what it left open fails there.

    What outlives its file is set aside, as caches of modules are: to visit all of it again after
    each of 370 files took a sixth of the suite's time.
    """
    yield
    gc.collect()
    gc.freeze()
