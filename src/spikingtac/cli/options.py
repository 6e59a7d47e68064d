"""The options of a verb: unknown ones are refused by their names, help shows no empty default."""

import inspect
import math
import shutil
import textwrap
import types
import typing
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import tyro

from spikingtac.atomic_files import require_free
from spikingtac.errors import ConfigError, nearest
from spikingtac.file_kinds import RECORDING_NAME

Output = Annotated[Path | None, tyro.conf.arg(aliases=["-o"])]  # Option -o: what is written.

NARROWEST = 40  # Width of a terminal below which help is not wrapped further, characters.
HELP = frozenset(("-h", "--help"))

# Options that must be above 0, whatever the verb.
POSITIVE = (
    "--seconds", "--seeds", "--workers", "--budget", "--limit-n", "--force-limit-n",
    "--travel-mm", "--travel-sigma-mm", "--travel-limit-mm",
)  # fmt: skip

OF_EVENTS = ("preset", "rate_hz", "sensor")  # Options of verbs that also read tracks.


def whole_numbers(count: int, names: str) -> Any:
    """Return the form of an option of so many numbers: of a plain tuple, the parser takes all."""
    return tyro.constructors.PrimitiveConstructorSpec(
        nargs=count,
        metavar=names,
        instance_from_str=lambda words: tuple(map(int, words)),
        is_instance=lambda value: isinstance(value, tuple),
        str_from_instance=lambda value: [str(value)],
    )


@dataclass(frozen=True, kw_only=True)
class JsonArgs:
    """The option of every verb.

    Attributes:
        json: Print one JSON object on stdout.
    """

    json: bool = False

    def refuse(self, why: str, *names: str, where: bool = True) -> None:
        """Refuse options that mean nothing beside the others.

        Args:
            why: What they are for, behind the option's name.
            *names: Their fields.
            where: Whether they mean nothing here.

        Raises:
            ConfigError: One is given.
        """
        for field in fields(self):
            if where and field.name in names and getattr(self, field.name) != field.default:
                option = field.name.replace("_", "-")
                raise ConfigError(f"--{option} {why}; leave it out, or see --help")


@dataclass(frozen=True, kw_only=True)
class WriteArgs(JsonArgs):
    """Options of verbs that write.

    Attributes:
        overwrite: Replace what is already there.
    """

    overwrite: bool = False

    def claim(self, *paths: Path | None, endings: Sequence[str] = ()) -> None:
        """Refuse files to write that are there already, before anything is computed.

        Args:
            *paths: The files.
            endings: Valid endings of their names; any unless given.

        Raises:
            ConfigError: One is there and --overwrite is not given, its folder is not, its ending is
                another, or it is among what is read.
        """
        given = [one if isinstance(one, tuple) else (one,) for one in vars(self).values()]
        named = [one for several in given for one in several if isinstance(one, Path)]
        for path in filter(None, paths):
            others = [one for one in named if one is not path]
            read = [*others, *(one / RECORDING_NAME for one in others)]
            if path.exists() and any(one.exists() and path.samefile(one) for one in read):
                raise ConfigError(f"{str(path)!r} is the input itself; give another name")
            require_free(path, self.overwrite, endings)


@dataclass(frozen=True, kw_only=True)
class ReadArgs(JsonArgs):
    """Options of verbs that read events.

    Attributes:
        sensor: Sensor to read of a folder (1 reads events_1.raw), or of a file with several
            cameras.
        strict: Refuse damage and another sensor's calibration, instead of a repair or a warning.
    """

    sensor: int | None = None
    strict: bool = False

    def open(self, source: Any, **options: Any) -> Any:
        """Return the source of events at a path; what is open already is returned as it is.

        Args:
            source: Path or address, or a source of events.
            **options: Further ones of :func:`spikingtac.open_events`.
        """
        if not isinstance(source, Path):
            return source
        import spikingtac as st

        return st.open_events(source, strict=self.strict, sensor=self.sensor, **options)


@dataclass(frozen=True, kw_only=True)
class RealtimeArgs(JsonArgs):
    """The option of verbs that may have deadlines.

    Attributes:
        realtime: For a camera: lock memory, collect no garbage, and run before other work where
            permitted.
    """

    realtime: bool = False


@dataclass(frozen=True, kw_only=True)
class TrackerArgs(JsonArgs):
    """Options of verbs that track events or read tracks.

    Attributes:
        calibration: calibration.json of this sensor; make one with: spikingtac calibrate.
        preset: Tracker: default (accurate), fast (10 kHz) or paper (as published), or a TOML file.
        rate_hz: Estimates per second; the preset's unless given.
    """

    calibration: Path | None = None
    preset: str = "default"
    rate_hz: float | None = None

    def needed_calibration(self) -> Path:
        """Return the calibration.

        Raises:
            ConfigError: None is given.
        """
        if self.calibration is None:
            raise ConfigError(
                "events need the sensor's calibration: --calibration calibration.json; "
                "make one with: spikingtac calibrate RECORDING -o calibration.json"
            )
        return self.calibration


def for_help(arguments: type) -> type:
    """Return a verb's arguments as its help shows them: without defaults such as None.

    Args:
        arguments: The verb's dataclass.
    """
    hints = typing.get_type_hints(arguments, include_extras=True)
    shown: dict[str, Any] = {}
    for field in fields(arguments):
        if field.default is MISSING and field.default_factory is MISSING:
            told = "(required)"  # the parser takes a list of any length for one that may be empty
        elif field.default is None or field.default is False or field.default == ():
            told = ""  # the text of the option says what happens without it
        else:
            continue
        shown[field.name] = Annotated[hints[field.name], tyro.conf.arg(help_behavior_hint=told)]
    names = {"__annotations__": shown, "__doc__": arguments.__doc__}
    return type(arguments.__name__, (arguments,), {**names, "__module__": arguments.__module__})


def about(arguments: type) -> str:
    """Return what a verb's docstring says before the list of its options."""
    return inspect.cleandoc(arguments.__doc__ or "").partition("\n\nAttributes:")[0]


def description(arguments: type) -> str:
    """Return a verb's text, wrapped to the terminal: the parser does not wrap it."""
    width = max(shutil.get_terminal_size().columns, NARROWEST)
    paragraphs = about(arguments).split("\n\n")
    # The parser joins lines that begin with a letter.
    indented = {"width": width, "initial_indent": " ", "subsequent_indent": " "}
    return "\n\n".join(textwrap.fill(" ".join(one.split()), **indented) for one in paragraphs)


def check_given(arguments: type, verb: str, given: Sequence[str]) -> list[str]:
    """Refuse the first unknown option, and the first value that its option cannot take.

    The parser asks for what is missing before it says what is unknown, so that a mistyped option
    would go unnamed where an argument is missing too. Of wrong values it names types of Python.

    Args:
        arguments: The verb's dataclass.
        verb: Its name, for the error.
        given: What was typed behind it.

    Returns:
        What the parser takes: 640x480 are two words.

    Raises:
        ConfigError: The verb has no such option, a number was needed, or one of some words; names
            the nearest one.
    """
    kinds = _options(arguments)
    words, typed = list[str](), []
    for word in given:
        name, *value = word.split("=", 1)
        for part in [name, *value] if kinds.get(name) == tuple[int, int] else [word]:
            of_two = words and kinds.get(words[-1]) == tuple[int, int]
            words += part.lower().split("x", 1) if of_two else [part]
    valid = [*kinds, "--help"]
    for place, word in enumerate(words, 1):
        name, equals, value = word.partition("=")
        typed.append((name.replace("_", "-"), [value] if equals else words[place:]))
    for name, _ in typed:
        if name.startswith("--") and name != "--" and name not in valid:
            raise ConfigError(
                f"spikingtac {verb} has no option {name!r}{nearest(name, valid)} "
                f"(valid: {', '.join(sorted(valid))})"
            )
    if HELP.isdisjoint(given):
        for name, values in typed:
            _check_value(name, values, kinds.get(name))
    return words


def _options(arguments: type) -> dict[str, Any]:
    """Return the options of a verb, aliases too, with the type of the one value of each."""
    hints = typing.get_type_hints(arguments, include_extras=True)
    plain = typing.get_type_hints(arguments)
    found: dict[str, Any] = {}
    for field in fields(arguments):
        notes: tuple[Any, ...] = getattr(hints[field.name], "__metadata__", ())
        if tyro.conf.Positional in notes:
            continue
        kind = plain[field.name]
        if typing.get_origin(kind) in (typing.Union, types.UnionType):
            kinds = [one for one in typing.get_args(kind) if one is not type(None)]
            kind = kinds[0] if len(kinds) == 1 else None
        aliases = [alias for note in notes for alias in getattr(note, "aliases", None) or ()]
        found |= dict.fromkeys(["--" + field.name.replace("_", "-"), *aliases], kind)
    return found


def _check_value(name: str, values: list[str], kind: Any) -> None:
    count, value = len(typing.get_args(kind)), values[0] if values else ""
    whole = [one for one in values[:count] if one.removeprefix("-").isdecimal()]
    if {*typing.get_args(kind)} == {int} and len(whole) < count:
        between, given = "a blank or an x" if count == 2 else "blanks", " ".join(values[:count])
        raise ConfigError(
            f"{name} takes {count} whole numbers with {between} between them, {given!r} is none"
        )
    if kind in (int, float):
        try:
            number = kind(value)
            if kind is float and not math.isfinite(number):
                raise ValueError
        except ValueError:
            needed = "a whole number" if kind is int else "a number"
            raise ConfigError(f"{name} takes {needed}, {value!r} is none") from None
        if name == "--seed" and number < 0:
            raise ConfigError(f"--seed is {value}, it must not be negative")
        if name in POSITIVE and number <= 0:
            raise ConfigError(f"{name} is {value}, it must be above 0")
    if typing.get_origin(kind) is typing.Literal:
        valid = [str(choice) for choice in typing.get_args(kind)]
        if value not in valid:
            raise ConfigError(
                f"{name} cannot be {value!r}{nearest(value, valid)} (valid: {', '.join(valid)})"
            )
