"""What a result depends on, as digests: the source code behind it, and the machine it ran on."""

from __future__ import annotations

import functools
import hashlib
import os
import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parents[1]

SIMULATOR = ("sim", "configs/cameras", "configs/scenes")
"""Where the recordings of the twin come from."""

VERSIONED = ("numpy", "scipy", "numba", "onnxruntime", "opencv-python-headless", "trackpy")
"""Packages whose versions stand in every report."""


@functools.cache
def code_digest(parts: tuple[str, ...]) -> str:
    """Return the sha256 (first 16 digits) of the sources of some parts of this package.

    Args:
        parts: Folders or modules below the package, as ``"markers"`` or ``"pipeline.py"``.
    """
    total = hashlib.sha256()
    for part in sorted(parts):
        path = PACKAGE / part
        files = sorted(path.rglob("*")) if path.is_dir() else [path]
        for file in files:
            if file.suffix in (".py", ".toml", ".onnx", ".json"):
                total.update(str(file.relative_to(PACKAGE)).encode())
                total.update(file.read_bytes())
    return total.hexdigest()[:16]


def provenance(command: str, settings: dict[str, Any]) -> dict[str, Any]:
    """Return what made a report: command, settings, code, versions, machine.

    Args:
        command: The line that makes it again.
        settings: Seeds and whatever else was chosen.
    """
    from spikingtac import __version__

    return {
        "command": command,
        "settings": settings,
        "package_version": __version__,
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
