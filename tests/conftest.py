"""Fixtures that every test may use."""

import atexit
import gc
import os
import shutil
import signal
import socket
import sys
import tempfile
from collections.abc import Generator, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import settings

from numba_cache import prepare_cache
from stand_ins.made_once import FOLDER_VARIABLE
from stand_ins.ur_controller import URController
from stand_ins.verbs import Verbs

# One test runs on each core: more threads make small products of matrices ten times as slow.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # begun in the background of a script
    signal.signal(signal.SIGINT, signal.default_int_handler)  # processes of tests are interrupted

# An example may take as long as other work on the machine makes it.
settings.register_profile("at leisure", deadline=None)
settings.load_profile("at leisure")

PROJECT = Path(__file__).resolve().parents[1]

if "PYTEST_XDIST_WORKER" not in os.environ:  # the workers take over what the controller set
    chosen = os.environ.get("NUMBA_CACHE_DIR", PROJECT / ".numba_cache")
    os.environ["NUMBA_CACHE_DIR"] = str(prepare_cache(Path(chosen), PROJECT / "src"))
    os.environ[FOLDER_VARIABLE] = tempfile.mkdtemp(prefix="spikingtac-tests-")
    atexit.register(shutil.rmtree, os.environ[FOLDER_VARIABLE], ignore_errors=True)


if sys.dont_write_bytecode:  # a program would compile the package at each of some 200 starts
    sys.dont_write_bytecode = False
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


def pytest_xdist_auto_num_workers() -> int:
    """Return one worker more than cores: while one waits for a camera or an arm, others work."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return (cores or 1) + 1


# What is tested first: what compiles the kernels, and the longest files. A long file at the end
# would keep one core busy alone.
FOLDERS = ("naive", "real", "integration")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the folders that take longest first; each file's tests keep their order."""
    first = {PROJECT / "tests" / name: place for place, name in enumerate(FOLDERS)}
    items.sort(key=lambda item: first.get(item.path.parent, len(FOLDERS)))


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Return the folder of test recordings, or skip where it is absent."""
    folder = Path(os.environ.get("SPIKINGTAC_DATA", PROJECT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"test recordings not found in {folder} (set SPIKINGTAC_DATA)")
    return folder


@pytest.fixture(scope="module")
def circling(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of circling discs, with their calibration."""
    from stand_ins.viewer import record_circling  # compiles: once the cache is prepared

    return record_circling(tmp_path_factory.mktemp("circling"))


@pytest.fixture
def discs_in_their_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the twin print every disc where its grid has it."""
    monkeypatch.setattr("spikingtac.sim.optics.POSITION_SIGMA_MM", 0.0)


@pytest.fixture
def controller() -> Iterator[URController]:
    """Return the controller of an arm, on an address of this machine."""
    pytest.importorskip("rtde_control", reason="the extra [robot] is not installed")
    with URController() as fake:
        yield fake


@pytest.fixture
def out() -> Iterator[socket.socket]:
    """Return one sender of datagrams: a camera listens to the first that it hears."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        yield sender


@contextmanager
def _one_thread(*_: object, **__: object) -> Iterator[Executor]:
    with ThreadPoolExecutor(1) as pool:
        yield pool


@pytest.fixture
def jobs_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do the work of a batch in this process, where nothing is said of the workers."""
    monkeypatch.setattr("spikingtac.batch.run.worker_pool", _one_thread)


@pytest.fixture
def verbs(capsys: pytest.CaptureFixture[str]) -> Verbs:
    """Return the command line, called in this process."""
    return Verbs(capsys)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Import all tests before garbage is collected: what they import stays."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


@pytest.fixture(scope="session", autouse=True)
def _nothing_left_open_at_the_end() -> Iterator[None]:
    """Set aside what was imported; at the end, collect what was dropped after its file."""
    gc.collect()
    gc.freeze()
    yield
    gc.unfreeze()
    gc.collect()


@pytest.fixture(scope="session", autouse=True)
def _own_priority() -> Iterator[None]:
    """Let no page, which steps back behind its session, slow the tests after it down."""
    with pytest.MonkeyPatch.context() as patch:
        if hasattr(os, "nice"):
            patch.setattr(os, "nice", lambda _: 0)
        yield


@pytest.fixture(scope="module", autouse=True)
def _nothing_left_open(_nothing_left_open_at_the_end: None) -> Iterator[None]:
    """Collect garbage after each file of tests, so that what it left open fails there.

    What outlives its file is set aside, as caches of modules are: to visit all of it again after
    each file took a sixth of the suite's time.
    """
    yield
    gc.collect()
    gc.freeze()
