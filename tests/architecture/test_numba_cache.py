"""A changed kernel reaches its callers in other files, and nothing else is compiled again."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from numba_cache import DIGESTS_NAME, KEPT_FOLDERS, prepare_cache

PACKAGE = "somepackage"
CALLEE = "from numba import njit\n@njit(cache=True)\ndef one():\n    return {value}\n"
CALLER = (
    "from numba import njit\n"
    f"from {PACKAGE}.callee import one\n"
    "@njit(cache=True)\ndef twice():\n    return 2 * one()\n"
)
BYSTANDER = "from numba import njit\n@njit(cache=True)\ndef none():\n    return 0\n"


def package(folder: Path) -> Path:
    made = folder / "src" / PACKAGE
    made.mkdir(parents=True)
    (made / "__init__.py").touch()
    (made / "callee.py").write_text(CALLEE.format(value=1), encoding="utf-8")
    (made / "caller.py").write_text(CALLER, encoding="utf-8")
    (made / "bystander.py").write_text(BYSTANDER, encoding="utf-8")
    return made


def twice(sources: Path, cache: Path) -> int:
    code = f"from {PACKAGE} import bystander, caller; bystander.none(); print(caller.twice())"
    folders = os.pathsep.join([str(sources.parent), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": folders}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, check=True, timeout=120
    )
    return int(done.stdout)


def test_a_changed_kernel_reaches_the_callers_of_other_files(tmp_path: Path) -> None:
    sources, root = package(tmp_path), tmp_path / "cache"
    before = prepare_cache(root, sources.parent)
    assert twice(sources, before) == 2
    assert len(list(before.glob("*/*.nbc"))) == 3
    (sources / "callee.py").write_text(CALLEE.format(value=21), encoding="utf-8")
    after = prepare_cache(root, sources.parent)
    kept = [entry.name.split(".")[0] for entry in after.glob("*/*.nbc")]
    assert kept == ["bystander"]
    assert twice(sources, after) == 42


def test_folders_of_former_sources_go(tmp_path: Path) -> None:
    sources, root = package(tmp_path), tmp_path / "cache"
    (root / "not-a-cache").mkdir(parents=True)
    for value in range(KEPT_FOLDERS + 2):
        (sources / "callee.py").write_text(CALLEE.format(value=value), encoding="utf-8")
        folder = prepare_cache(root, sources.parent)
        os.utime(folder, (value, value))
    left = [path for path in root.iterdir() if (path / DIGESTS_NAME).is_file()]
    assert folder in left
    assert len(left) == KEPT_FOLDERS
    assert (root / "not-a-cache").is_dir()
