"""The folder of a run: the settings that it was begun with; results of others are never added."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from spikingtac.atomic_files import write_json
from spikingtac.errors import ConfigError

RUN = "run.json"
"""The settings that the folder was begun with."""


def begin_run(folder: Path, settings: Mapping[str, Any], resume: bool) -> None:
    """Begin a run in a folder, or continue the one in it.

    Args:
        folder: Is created if it does not exist.
        settings: The settings of the run; a folder holds the results of one set of them.
        resume: Whether a run with the same settings may continue.

    Raises:
        ConfigError: The folder holds something else, or results of other settings; names them.
    """
    given = json.loads(json.dumps(settings))
    begun = folder / RUN
    if begun.is_file():
        stored = json.loads(begun.read_text(encoding="utf-8"))
        changed = sorted(key for key in {*stored, *given} if stored.get(key) != given.get(key))
        if changed:
            text = ", ".join(f"{key} {stored.get(key)!r} -> {given.get(key)!r}" for key in changed)
            raise ConfigError(
                f"{str(folder)!r} holds results with other settings ({text}); results are never "
                "mixed: give a new folder, or the settings of the old one"
            )
        if not resume:
            raise ConfigError(
                f"{str(folder)!r} holds a run with these settings; "
                "continue it with --resume, or give a new folder"
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
