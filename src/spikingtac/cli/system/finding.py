"""What a check of this machine found."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class Finding:
    """What a check found.

    Attributes:
        name: What was looked at.
        status: ``ok``, ``note`` (works, could be better) or ``fail`` (something will not work).
        found: What is there.
        remedy: What to do about it, empty where nothing is to be done.
    """

    name: str
    status: str
    found: str
    remedy: str = ""
