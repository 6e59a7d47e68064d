"""The folder of a run: the settings that it was begun with; results of others are never added."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from spikingtac.atomic_files import write_json
from spikingtac.errors import ConfigError

RUN = "run.json"  # The settings that the folder was begun with.


def begin_run(
    folder: Path, settings: Mapping[str, Any], resume: bool, overwrite: bool = False
) -> None:
    """Begin a run in a folder, or continue the one in it.

    Args:
        folder: Is created if it does not exist.
        settings: The settings of the run; a folder holds the results of one set of them.
        resume: Whether a run with the same settings may continue.
        overwrite: Whether a run that is there is removed; nothing else ever is.

    Raises:
        ConfigError: The folder holds something else, or results of other settings; names them.
    """
    if resume and overwrite:
        raise ConfigError("--resume goes on with a run, --overwrite removes it: give one of them")
    given = json.loads(json.dumps(settings))
    begun = folder / RUN
    if overwrite and begun.is_file():
        _empty(folder)
    if begun.is_file():
        stored = json.loads(begun.read_text(encoding="utf-8"))
        changed = sorted(key for key in {*stored, *given} if stored.get(key) != given.get(key))
        if changed:
            text = ", ".join(f"{key} {stored.get(key)!r} -> {given.get(key)!r}" for key in changed)
            raise ConfigError(
                f"{str(folder)!r} holds results with other settings ({text}); results are never "
                "mixed: give a new folder, the settings of the old one, or --overwrite"
            )
        if not resume:
            raise ConfigError(
                f"{str(folder)!r} holds a run with these settings; "
                "continue it with --resume, replace it with --overwrite, or give a new folder"
            )
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise ConfigError(
                f"{str(folder)!r} is not empty and holds no run; give a new or an empty folder"
            )
        write_json(begun, given)
    except OSError as error:
        raise ConfigError(f"cannot write into {str(folder)!r}: {error.strerror}") from error


def _empty(folder: Path) -> None:
    """Remove a run; its settings last, so that an interrupted removal is still known as a run."""
    begun = folder / RUN
    try:
        for path in [path for path in folder.iterdir() if path != begun]:
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()
        begun.unlink()
    except OSError as error:
        raise ConfigError(f"cannot remove the run in {str(folder)!r}: {error.strerror}") from error
