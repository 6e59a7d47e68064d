"""Files that are written whole or not at all: a temporary file takes the place of the old one."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder; it replaces ``path`` when the block ends.

    An interrupt or an error leaves the old file as it was, and no temporary one. The folder is
    created if it does not exist. The temporary name keeps the ending of ``path``, since many
    writers choose their format by it.

    Args:
        path: File to write.

    Yields:
        The path that the block has to write.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f"{path.stem}.{os.getpid()}.partial{path.suffix}")
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a JSON document, whole or not at all.

    Raises:
        ValueError: A number is not finite.
    """
    write_text(path, json.dumps(document, indent=1, allow_nan=False) + "\n")
