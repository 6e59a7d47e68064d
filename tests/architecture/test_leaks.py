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


def test_a_socket_left_open_fails_its_own_file(tmp_path: Path) -> None:
    (tmp_path / "test_a.py").write_text(LEAKS)
    (tmp_path / "test_b.py").write_text("def test_that_leaves_nothing():\n    pass\n")
    config = ("-c", str(TESTS.parent / "pyproject.toml"), "--rootdir", str(tmp_path))
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n", "0", *config, "-p", "conftest", str(tmp_path)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={"PYTHONPATH": str(TESTS), "PATH": "", "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
    )
    assert done.returncode == 1, done.stdout
    assert "2 passed, 1 error" in done.stdout
    assert "ERROR test_a.py" in done.stdout
