"""A changed kernel reaches its callers in other files, and nothing else is compiled again."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from numba_cache import DIGESTS_NAME, KEPT_FOLDERS, closure_digests, prepare_cache

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


def test_imports_within_functions_and_for_annotations_count(tmp_path: Path) -> None:
    sources = package(tmp_path)
    head = "from typing import TYPE_CHECKING\nfrom numba import njit\n"
    late = f"def f():\n    from {PACKAGE} import callee\n"
    typed = f"if TYPE_CHECKING:\n    from {PACKAGE}.callee import one\n"
    (sources / "late.py").write_text(head + late, encoding="utf-8")
    (sources / "typed.py").write_text(head + typed, encoding="utf-8")
    before = closure_digests(sources.parent)
    (sources / "callee.py").write_text(CALLEE.format(value=5), encoding="utf-8")
    after = closure_digests(sources.parent)
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {f"{PACKAGE}/{name}.py" for name in ("callee", "caller", "late", "typed")}
