"""The folder of a run: what it was made with, and that nothing else is mixed into it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from spikingtac.errors import ConfigError

RUN = "run.json"
"""What the folder was begun with."""

REPORT = "report.json"


def claim(folder: Path, settings: Mapping[str, Any], resume: bool) -> None:
    """Begin a run in a folder, or go on with one.

    Args:
        folder: Created if it does not exist.
        settings: What was chosen; a folder holds the results of one choice only.
        resume: Whether a run that was begun may go on.

    Raises:
        ConfigError: The folder holds something else, or results of other settings; names them.
    """
    wanted = json.loads(json.dumps(settings))
    begun = folder / RUN
    if begun.is_file():
        held = json.loads(begun.read_text(encoding="utf-8"))
        changed = sorted(key for key in {*held, *wanted} if held.get(key) != wanted.get(key))
        if changed:
            told = ", ".join(f"{key} {held.get(key)!r} -> {wanted.get(key)!r}" for key in changed)
            raise ConfigError(
                f"{str(folder)!r} holds results with other settings ({told}); results are never "
                "mixed: give a new folder, or the settings of the old one"
            )
        if not resume:
            raise ConfigError(
                f"{str(folder)!r} holds a run with these settings; "
                "go on with --resume, or give a new folder"
            )
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise ConfigError(
                f"{str(folder)!r} is not empty and holds no run; give a new or an empty folder"
            )
        write_json(begun, wanted)
    except OSError as error:
        raise ConfigError(f"cannot write into {str(folder)!r}: {error.strerror}") from error


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a document at once: an interrupt leaves the old one or the new one."""
    write_text(path, json.dumps(document, indent=1, allow_nan=False) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text at once; see :func:`write_json`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)
