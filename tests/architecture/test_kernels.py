"""Kernels: compiled anew where one that they call has changed, and the same in every cache.

A kernel whose sums may be regrouped exists once: it is compiled into its caller.

Numba keeps a called kernel twice, in its own object code and in its caller's, and optimises each by
itself. Where sums may be regrouped (``fastmath``) the two round differently, and which of them runs
depends on what the cache holds: tracks differed by 3e-5 px between a cold and a warm cache.
"""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from numba_cache import prepare_cache
from stand_ins.source_trees import FILES, PACKAGE, text_of, tree_of

NAME = "somepackage"
CALLEE = "from numba import njit\n@njit(cache=True)\ndef one():\n    return {value}\n"
CALLER = (
    "from spikingtac.kernels import kernel\n"
    f"from {NAME}.callee import one\n"
    "@kernel()\ndef twice():\n    return 2 * one()\n"
)
BYSTANDER = "from numba import njit\n@njit(cache=True)\ndef none():\n    return 0\n"


def compiled(tree: ast.AST) -> list[tuple[ast.FunctionDef, dict[str, ast.expr]]]:
    """Return the compiled functions of a file with the options that they are compiled with."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            for call in node.decorator_list:
                if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "njit":
                    found.append((node, {k.arg or "": k.value for k in call.keywords}))
    return found


def may_regroup(fastmath: ast.expr | None) -> bool:
    """Return whether sums may be regrouped; the set ``SAME_BITS`` allows nothing of that kind."""
    return fastmath is not None and getattr(fastmath, "id", "") != "SAME_BITS"


def test_regrouped_sums_are_compiled_into_their_callers() -> None:
    trees = {path: tree_of(path) for path in FILES if "njit" in text_of(path)}
    kernels = [(path, *kernel) for path, tree in trees.items() for kernel in compiled(tree)]
    called = {
        node.func.id
        for _, function, _ in kernels
        for node in ast.walk(function)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }
    assert len(kernels) >= 50  # it looks at something
    regrouped = [entry for entry in kernels if may_regroup(entry[2].get("fastmath"))]
    twice = [
        f"{path.relative_to(PACKAGE)}: {function.name}"
        for path, function, options in regrouped
        if function.name in called and "forceinline" not in options
    ]
    assert twice == [], "add forceinline=True"


def package(folder: Path) -> Path:
    made = folder / "src" / NAME
    made.mkdir(parents=True)
    (made / "__init__.py").touch()
    (made / "callee.py").write_text(CALLEE.format(value=1), encoding="utf-8")
    (made / "caller.py").write_text(CALLER, encoding="utf-8")
    (made / "bystander.py").write_text(BYSTANDER, encoding="utf-8")
    return made


def twice(sources: Path, cache: Path) -> int:
    code = f"from {NAME} import bystander, caller; bystander.none(); print(caller.twice())"
    folders = os.pathsep.join([str(sources.parent), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": folders}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, check=True, timeout=120
    )
    return int(done.stdout)


def test_a_changed_kernel_reaches_the_callers_of_other_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sources, root = package(tmp_path), tmp_path / "cache"
    monkeypatch.syspath_prepend(sources.parent)
    before = prepare_cache(root, sources.parent)
    assert twice(sources, before) == 2
    assert len(list(before.glob("*/*.nbc"))) == 3
    (sources / "callee.py").write_text(CALLEE.format(value=21), encoding="utf-8")
    after = prepare_cache(root, sources.parent)
    kept = [entry.name.split(".")[0] for entry in after.glob("*/*.nbc")]
    assert kept == ["bystander"]
    assert twice(sources, after) == 42
