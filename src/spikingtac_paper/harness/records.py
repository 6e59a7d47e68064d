"""Records of finished work on disk, each under the digest of everything that it depends on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

Record = dict[str, Any]
"""A record as JSON holds it; ``key`` is the digest."""


def load_record(path: Path, key: str) -> Record | None:
    """Return the record of a file, or None where there is none with this key."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record if record.get("key") == key else None
