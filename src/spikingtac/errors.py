"""The errors a user can meet; each says what was given, what is valid and what to do next.

The command line maps them to exit codes: 1 the input is at fault, 2 the arguments are,
3 the machine is.
"""

import difflib
import os
from collections.abc import Iterable, Mapping
from importlib import import_module
from typing import Any, TypeVar

T = TypeVar("T")

PATH = str | os.PathLike  # What names a file.
SHORTEST_STEM = 4  # Letters of a name that a longer word must begin with to be taken for it.


class SpikingTacError(Exception):
    """Base of every error that this package raises on purpose."""

    exit_code = 1


class RecordingError(SpikingTacError):
    """A recording cannot be read: missing, foreign, or damaged beyond what was allowed."""


class FormatError(RecordingError):
    """The bytes do not fit the format that the file's name or header claims."""


class DamageError(RecordingError):
    """Damage was found and the caller asked for none (``strict``)."""


class CalibrationError(SpikingTacError):
    """The calibration cannot be made or read; names the markers that are missing."""


class ConfigError(SpikingTacError, ValueError):
    """A setting or an argument is unknown or out of range; names the nearest valid one."""

    exit_code = 2


class SettingsFileError(ConfigError):
    """A file of settings is damaged, or a key or value in it does not fit."""

    exit_code = 1


class MissingExtraError(SpikingTacError):
    """An optional library is not installed; names the extra that brings it."""

    exit_code = 3


class DeviceError(SpikingTacError):
    """A camera, robot or gripper does not answer as it should."""

    exit_code = 3


class CameraLostError(DeviceError):
    """A camera that was delivering is gone: unplugged, switched off, or its sender ended."""


class SearchError(SpikingTacError):
    """A search by touch cannot go on: no wall, no room, or contacts that make no hole."""


def nearest(name: str, valid: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the closest valid name, or an empty string."""
    names, name = list(valid), str(name)
    # A word of the same stem is meant rather than one of similar letters: tracking is track.
    stems = [known for known in names if len(known) >= SHORTEST_STEM and name.startswith(known)]
    close = sorted(stems, key=len)[-1:] or difflib.get_close_matches(name, names, n=1)
    return f"; did you mean {close[0]!r}?" if close else ""


def named(table: Mapping[str, T], name: str, kind: str) -> T:
    """Return the entry of a name.

    Args:
        table: Name -> entry.
        name: What was asked for.
        kind: What the entries are, for the error.

    Raises:
        ConfigError: There is no entry of that name; names the nearest one.
    """
    if name not in list(table):  # also a name that has no hash
        raise ConfigError(
            f"unknown {kind} {name!r}{nearest(name, table)} (valid: {', '.join(table)})"
        )
    return table[name]


def require_type(given: object, kind: Any, way: str) -> None:
    """Refuse what is not of a kind.

    Args:
        given: What was passed, such as the name or the path of what is expected.
        kind: What is expected.
        way: How to get it, for the error.

    Raises:
        ConfigError: It is something else.
    """
    if not isinstance(given, kind):
        text = repr(given) if isinstance(given, str | os.PathLike) else type(given).__name__
        expected = "the path of a file" if kind is PATH else kind.__name__
        raise ConfigError(f"expected {expected}, given {text}; make one: spikingtac.{way}")


def import_extra(module: str, what: str, extra: str) -> Any:
    """Return a module of an optional library.

    Args:
        module: Its name.
        what: What needs it, for the error.
        extra: The extra of this package that brings it.

    Raises:
        MissingExtraError: It is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        raise MissingExtraError(
            f"{what} needs {library}; install it with: pip install 'spikingtac[{extra}]'"
        ) from error
