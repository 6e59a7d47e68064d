"""What a result depends on: digests of the source code, versions, and the machine."""

from __future__ import annotations

import functools
import hashlib
import os
import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

SOURCES = Path(__file__).resolve().parents[2]
PACKAGES = ("spikingtac", "spikingtac_paper")
CODE = (".py", ".toml", ".onnx", ".json")

VERSIONED = ("numpy", "scipy", "numba", "onnxruntime", "opencv-python-headless", "trackpy")
"""Packages whose versions every report states."""


@functools.cache
def code_digest() -> str:
    """Return the sha256 (first 16 digits) of the product's and the experiments' sources.

    Stored results carry it: a run continues only with the code that began it.
    """
    total = hashlib.sha256()
    for package in PACKAGES:
        for file in sorted((SOURCES / package).rglob("*")):
            if file.suffix in CODE:
                total.update(str(file.relative_to(SOURCES)).encode())
                total.update(file.read_bytes())
    return total.hexdigest()[:16]


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
        "code_sha256": code_digest(),
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
            cwd=SOURCES,
            capture_output=True,
            text=True,
            timeout=10,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() or None
