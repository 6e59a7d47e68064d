"""What a result depends on: digests of the source code, versions, and the machine."""

from __future__ import annotations

import ast
import functools
import hashlib
import os
import platform
import subprocess
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parents[2]

SIMULATOR = ("sim/scene/render.py",)
"""The modules that render recordings of the twin; the scene has a digest of its own."""

SHARED = (
    "atomic_files.py",
    "errors.py",
    "schema.py",
    "types.py",
    "calibration/document.py",
    "calibration/step_maps.py",
)
"""Modules that everything imports: containers and messages. They compute no result."""

VERSIONED = ("numpy", "scipy", "numba", "onnxruntime", "opencv-python-headless", "trackpy")
"""Packages whose versions every report states."""


@functools.cache
def code_digest(parts: tuple[str, ...]) -> str:
    """Return the sha256 (first 16 digits) of the sources of parts of this package.

    Args:
        parts: Folders or modules below the package, as ``"markers"`` or ``"pipeline/follow.py"``.
    """
    total = hashlib.sha256()
    for part in sorted(parts):
        for file in _files(PACKAGE / part):
            total.update(str(file.relative_to(PACKAGE)).encode())
            total.update(file.read_bytes())
    return total.hexdigest()[:16]


@functools.cache
def modules_behind(parts: tuple[str, ...], within: str = "") -> tuple[str, ...]:
    """Return parts of this package and all modules that they import, directly or not.

    Stored results carry the digest of these modules. A change of one tracker therefore renews the
    results of this tracker and no others.

    Args:
        parts: Folders or modules below the package.
        within: Only imports from this folder are followed; all unless given.
    """
    waiting = [file for part in parts for file in _files(PACKAGE / part)]
    found: set[str] = set()
    while waiting:
        file = waiting.pop()
        name = file.relative_to(PACKAGE).as_posix()
        if name in found or name in SHARED:
            continue
        found.add(name)
        if file.suffix == ".py":
            waiting += [one for one in _imported(file) if one.is_relative_to(PACKAGE / within)]
    return tuple(sorted(found))


def _imported(file: Path) -> Iterator[Path]:
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        for name in names:
            first, *rest = name.split(".")
            path = PACKAGE.joinpath(*rest)
            if first == PACKAGE.name and rest:
                yield from (
                    p for p in (path.with_suffix(".py"), path / "__init__.py") if p.is_file()
                )


def _files(path: Path) -> list[Path]:
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    return [file for file in files if file.suffix in (".py", ".toml", ".onnx", ".json")]


def provenance(command: str, settings: dict[str, Any]) -> dict[str, Any]:
    """Return how a report was made: command, settings, code, versions, machine.

    Args:
        command: The command line that repeats the run.
        settings: The settings of the run.
    """
    from spikingtac._version import package_version

    return {
        "command": command,
        "settings": settings,
        "package_version": package_version(),
        "code_sha256": code_digest(("",)),
        "git_commit": _commit(),
        "python": platform.python_version(),
        "versions": {name: version for name in VERSIONED if (version := _version(name))},
        "machine": platform.machine(),
        "system": platform.system(),
        "cpus": os.cpu_count(),
    }


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _commit() -> str | None:
    try:
        done = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=12"],
            cwd=PACKAGE,
            capture_output=True,
            text=True,
            timeout=10,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() or None
