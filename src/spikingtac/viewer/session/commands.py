"""What a page may ask for; everything else is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

LONGEST_COMMAND = 1024
"""Characters; a page never needs more."""
SLOWEST, FASTEST = 0.01, 10.0
"""Speeds of playback, relative to the recording's own time."""
SHORTEST_EXPOSURE_US, LONGEST_EXPOSURE_US = 500, 500_000
LATEST_US = 1 << 53
"""Integers beyond it are not exact in a browser."""


class CommandError(ValueError):
    """A message from a page that is no command."""


def parse_command(text: str) -> tuple[str, Any]:
    """Return ``(name, value)`` of a command.

    Commands are JSON objects of one key: ``ack``, ``play``, ``speed``, ``seek_us``,
    ``exposure_us``, ``map``, ``set`` (a list of a control's name and its value), ``defaults``,
    ``reset`` (of the watchdog), ``calibrate`` or ``begin_anew`` (the guide of a calibration),
    ``list`` (look again which recordings there are) or ``open`` (the name of one of them).

    Raises:
        CommandError: The text is anything else.
    """
    if len(text) > LONGEST_COMMAND:
        raise CommandError(f"{len(text)} characters, at most {LONGEST_COMMAND} are valid")
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise CommandError("no JSON") from error
    if not isinstance(document, dict) or len(document) != 1:
        raise CommandError("a command is a JSON object of one key")
    ((name, value),) = document.items()
    fits = _RULES.get(name)
    if fits is None or not fits(value):
        raise CommandError(f"{name!r} is unknown, or its value is out of range")
    return name, value


def _whole(low: int, high: int) -> Callable[[Any], bool]:
    return lambda value: type(value) is int and low <= value <= high


def _setting(value: Any) -> bool:
    if not isinstance(value, list) or len(value) != 2 or not isinstance(value[0], str):
        return False
    return isinstance(value[1], bool | int | float | str)


_RULES: dict[str, Callable[[Any], bool]] = {
    "ack": _whole(0, LATEST_US),
    "play": lambda value: isinstance(value, bool),
    "speed": lambda value: type(value) in (int, float) and SLOWEST <= value <= FASTEST,
    "seek_us": _whole(-LATEST_US, LATEST_US),
    "exposure_us": _whole(SHORTEST_EXPOSURE_US, LONGEST_EXPOSURE_US),
    "map": lambda value: isinstance(value, bool),
    "set": _setting,
    "defaults": lambda value: value is True,
    "reset": lambda value: value is True,
    "calibrate": lambda value: value is True,
    "begin_anew": lambda value: value is True,
    "list": lambda value: value is True,
    "open": lambda value: isinstance(value, str) and bool(value),
}
