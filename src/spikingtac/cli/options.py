"""Refuse options that a verb does not have, by their names."""

from __future__ import annotations

import typing
from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any

import tyro

from spikingtac.errors import ConfigError, nearest

COMMON = ("--help",)
"""Options of every verb that its dataclass does not list."""


def check_options(arguments: type, verb: str, given: Sequence[str]) -> None:
    """Refuse the first unknown option.

    The parser asks for what is missing before it says what is unknown, so that a mistyped option
    would go unnamed where an argument is missing too.

    Args:
        arguments: The verb's dataclass.
        verb: Its name, for the error.
        given: What was typed behind it.

    Raises:
        ConfigError: The verb has no such option; names the nearest one.
    """
    valid = [*_options(arguments), *COMMON]
    for word in given:
        name = word.partition("=")[0].replace("_", "-")
        if name.startswith("--") and name != "--" and name not in valid:
            raise ConfigError(
                f"spikingtac {verb} has no option {name!r}{nearest(name, valid)} "
                f"(valid: {', '.join(sorted(valid))})"
            )


def _options(arguments: type) -> Iterator[str]:
    hints = typing.get_type_hints(arguments, include_extras=True)
    for field in fields(arguments):
        notes: tuple[Any, ...] = getattr(hints[field.name], "__metadata__", ())
        if tyro.conf.Positional in notes:
            continue
        yield "--" + field.name.replace("_", "-")
        for note in notes:
            yield from getattr(note, "aliases", None) or ()
