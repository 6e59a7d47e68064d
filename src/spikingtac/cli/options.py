"""The options of a verb: unknown ones are refused by their names, help shows no empty default."""

from __future__ import annotations

import inspect
import shutil
import textwrap
import types
import typing
from collections.abc import Iterator, Sequence
from dataclasses import MISSING, Field, dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import tyro

from spikingtac.atomic_files import require_free
from spikingtac.errors import ConfigError, nearest

Output = Annotated[Path | None, tyro.conf.arg(aliases=["-o"])]  # Option -o: what is written.


@dataclass(frozen=True, kw_only=True)
class JsonArgs:
    """The option of every verb."""

    json: bool = False
    """Print one JSON object on stdout."""


@dataclass(frozen=True, kw_only=True)
class WriteArgs(JsonArgs):
    """Options of verbs that write."""

    overwrite: bool = False
    """Replace what is already there."""

    def claim(self, *paths: Path | None) -> None:
        """Refuse files to write that are there already, before anything is computed.

        Raises:
            ConfigError: One is there and --overwrite is not given, or its folder is not.
        """
        for path in paths:
            if path is not None:
                require_free(path, self.overwrite)


@dataclass(frozen=True, kw_only=True)
class ReadArgs(JsonArgs):
    """Options of verbs that read events."""

    sensor: int | None = None
    """Sensor to read of a folder (1 reads events_1.raw), or of a file with several cameras."""
    strict: bool = False
    """Refuse damage instead of repairing and counting it, and the calibration of another sensor
    instead of a warning."""


@dataclass(frozen=True, kw_only=True)
class TrackerArgs(ReadArgs):
    """Options of verbs that track events or read tracks."""

    calibration: Path | None = None
    """calibration.json of this sensor; make one with: spikingtac calibrate."""
    preset: str = "default"
    """Tracker: default (accurate), fast (10 kHz) or paper (as published), or a TOML file."""
    rate_hz: float | None = None
    """Estimates per second; the preset's unless given."""


COMMON = ("--help",)  # Options of every verb that its dataclass does not list.

NARROWEST = 40  # Width of a terminal below which help is not wrapped further, characters.
HELP = frozenset(("-h", "--help"))

# Defaults that say nothing to a reader: the text of the option says what happens without it.
EMPTY: tuple[object, ...] = (None, False, ())


def for_help(arguments: type) -> type:
    """Return a verb's arguments as its help shows them: without defaults such as None.

    Args:
        arguments: The verb's dataclass.
    """
    hints = typing.get_type_hints(arguments, include_extras=True)
    shown = {
        field.name: Annotated[hints[field.name], tyro.conf.arg(help_behavior_hint=hint)]
        for field in fields(arguments)
        if (hint := _hint(field)) is not None
    }
    names = {"__annotations__": shown, "__doc__": arguments.__doc__}
    return type(arguments.__name__, (arguments,), {**names, "__module__": arguments.__module__})


def description(arguments: type) -> str:
    """Return a verb's docstring, wrapped to the terminal: the parser does not wrap it."""
    width = max(shutil.get_terminal_size().columns, NARROWEST)
    paragraphs = inspect.cleandoc(arguments.__doc__ or "").split("\n\n")
    # The parser joins lines that begin with a letter.
    indented = {"width": width, "initial_indent": " ", "subsequent_indent": " "}
    return "\n\n".join(textwrap.fill(" ".join(one.split()), **indented) for one in paragraphs)


def _hint(field: Field[Any]) -> str | None:
    """Return what stands behind the text of an option, or None for its default."""
    if field.default is MISSING and field.default_factory is MISSING:
        return "(required)"  # the parser takes a list of any length for one that may be empty
    return "" if any(field.default is empty for empty in EMPTY) else None


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


def check_values(arguments: type, given: Sequence[str]) -> None:
    """Refuse the first value that its option cannot take: the parser names types of Python.

    Args:
        arguments: The verb's dataclass.
        given: What was typed behind it.

    Raises:
        ConfigError: A number was needed, or one of some words; names the nearest one.
    """
    hints = typing.get_type_hints(arguments)
    kinds = {"--" + field.name.replace("_", "-"): hints[field.name] for field in fields(arguments)}
    for word, following in zip(given, [*given, ""][1:], strict=True):
        name, equals, value = word.partition("=")
        kind = _one_value(kinds.get(name.replace("_", "-")))
        value = value if equals else following
        if kind in (int, float) and not _is_number(value, kind):
            needed = "a whole number" if kind is int else "a number"
            raise ConfigError(f"{name} takes {needed}, {value!r} is none")
        if typing.get_origin(kind) is typing.Literal:
            valid = [str(choice) for choice in typing.get_args(kind)]
            if value not in valid:
                raise ConfigError(
                    f"{name} cannot be {value!r}{nearest(value, valid)} (valid: {', '.join(valid)})"
                )


def _one_value(hint: Any) -> Any:
    """Return the type of an option with one value, without None; None of any other option."""
    kinds = [kind for kind in typing.get_args(hint) if kind is not type(None)]
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return kinds[0] if len(kinds) == 1 else None
    return hint


def _is_number(text: str, kind: type) -> bool:
    try:
        kind(text)
    except ValueError:
        return False
    return True


def _options(arguments: type) -> Iterator[str]:
    hints = typing.get_type_hints(arguments, include_extras=True)
    for field in fields(arguments):
        notes: tuple[Any, ...] = getattr(hints[field.name], "__metadata__", ())
        if tyro.conf.Positional in notes:
            continue
        yield "--" + field.name.replace("_", "-")
        for note in notes:
            yield from getattr(note, "aliases", None) or ()
