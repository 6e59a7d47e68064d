"""What a test leaves open fails in the file that opened it."""

import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]

LEAKS = """
import socket

def test_that_leaves_a_socket_in_a_reference_cycle():
    ring = [socket.socket()]
    ring.append(ring)
"""


LEAKS_LATER = """
import socket, sys

def test_that_keeps_a_socket_beyond_its_file():
    sys.kept = [socket.socket()]
    sys.kept.append(sys.kept)
"""

DROPS = """
import sys

def test_that_drops_it():
    del sys.kept
"""


def test_a_socket_that_is_left_open_fails_the_run(tmp_path: Path) -> None:
    """One fails its own file; one that a later file drops is found at the end at the latest."""
    (tmp_path / "test_a.py").write_text(LEAKS)
    (tmp_path / "test_b.py").write_text("def test_that_leaves_nothing():\n    pass\n")
    (tmp_path / "test_c.py").write_text(LEAKS_LATER)
    (tmp_path / "test_d.py").write_text(DROPS)
    said = failure(tmp_path)
    assert "4 passed, 2 errors" in said
    assert "ERROR test_a.py" in said
    assert "ERROR test_b.py" not in said
    assert "ERROR test_c.py" not in said


def failure(folder: Path) -> str:
    """Return what is said of a folder of tests that fails."""
    config = ("-c", str(TESTS.parent / "pyproject.toml"), "--rootdir", str(folder))
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n", "0", *config, "-p", "conftest", str(folder)],
        capture_output=True,
        text=True,
        cwd=folder,
        env={"PYTHONPATH": str(TESTS), "PATH": "", "NUMBA_CACHE_DIR": str(folder / "cache")},
    )
    assert done.returncode == 1, done.stdout
    return done.stdout
