"""Strict TOML for frozen dataclasses: unknown keys are refused with the nearest valid name."""

import contextlib
import dataclasses
import json
import os
import re
import tomllib
import types
import typing
from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeVar

from spikingtac.errors import ConfigError, SettingsFileError, nearest

T = TypeVar("T")


LARGEST = 1e300  # Largest number of a setting.

# Largest file of settings, bytes, and deepest nesting of its tables and lists.
MOST_BYTES, DEEPEST = 1 << 20, 32

# A dotted key of a hundred parts.
LONG_KEY = re.compile(r"""(?:(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){100}""")


def read_toml(path: str | Path) -> dict[str, Any]:
    """Parse a TOML file.

    Raises:
        ConfigError: The file cannot be read.
        SettingsFileError: It is no TOML (with line and column), too long or nested too deep.
    """
    try:
        raw = Path(path).read_bytes()
        if len(raw) > MOST_BYTES:
            raise SettingsFileError(f"{str(path)!r} is longer than {MOST_BYTES} bytes")
        text = raw.decode()
        # The parser takes memory with the square of the parts of a dotted key.
        mapping = None if LONG_KEY.search(text) else tomllib.loads(text)
    except OSError as error:
        raise ConfigError(f"cannot read {str(path)!r}: {error.strerror}") from error
    except ValueError as error:  # also an integer of thousands of digits
        raise SettingsFileError(f"{str(path)!r} is not valid TOML: {error}") from error
    except RecursionError:
        mapping = None
    level: list[Any] = [mapping]
    for _ in range(DEEPEST):
        inner = (
            v.values() if isinstance(v, dict) else v for v in level if isinstance(v, dict | list)
        )
        level = [value for values in inner for value in values]
    if mapping is None or level:
        raise SettingsFileError(f"{str(path)!r} is nested deeper than {DEEPEST} tables or lists")
    return mapping


def stored_file(name: str | Path, folder: Path, names: Sequence[str], kind: str) -> Path:
    """Return the TOML file of a name in a folder of the package, or a path as it is.

    Raises:
        ConfigError: It is neither; names the nearest name.
    """
    text = str(name)
    if text in names:
        return folder / f"{text}.toml"
    if not text.endswith(".toml") and os.sep not in text:
        raise ConfigError(
            f"unknown {kind} {text!r}{nearest(text, names)} "
            f"(valid: {', '.join(names)}, or the path of a TOML file)"
        )
    return Path(name)


def from_toml(cls: type[T], path: str | Path) -> T:
    """Build a dataclass from a TOML file; see :func:`build`.

    Raises:
        ConfigError: The file cannot be read.
        SettingsFileError: It is no TOML, or a key or value does not fit.
    """
    mapping = read_toml(path)
    try:
        return build(cls, mapping, str(path))
    except ConfigError as error:
        raise SettingsFileError(str(error)) from error


def build(cls: type[T], mapping: Mapping[str, Any], where: str) -> T:
    """Build a dataclass from a mapping, table by table.

    Args:
        cls: A dataclass; fields may be numbers, strings, booleans, tuples, optional values,
            other dataclasses, or tuples of dataclasses (TOML arrays of tables).
        mapping: Parsed TOML or JSON.
        where: Name of the document or table, for errors.

    Raises:
        ConfigError: A key is unknown or missing, or a value has the wrong type or range; names the
            key, what was given and what is valid.
    """
    hints = typing.get_type_hints(cls)
    fields = {field.name: field for field in dataclasses.fields(cls) if field.init}  # type: ignore[arg-type]
    for key in mapping:
        if key not in fields:
            raise ConfigError(
                f"{where}: unknown key {key!r}{nearest(key, fields)} "
                f"(valid: {', '.join(sorted(fields))})"
            )
    values = {key: _convert(hints[key], value, f"{where}.{key}") for key, value in mapping.items()}
    for name, field in fields.items():
        none = dataclasses.MISSING
        if name not in values and field.default is none and field.default_factory is none:
            raise ConfigError(f"{where}: the key {name!r} is missing")
        low, high = field.metadata.get("range") or field.metadata.get("valid") or (None, None)
        value = values.get(name)
        if low is not None and value is not None and not low <= value <= high:
            raise ConfigError(f"{where}.{name} is {value:g}, valid are {low:g} to {high:g}")
    try:
        return cls(**values)
    except ConfigError:
        raise
    except (ValueError, TypeError, OverflowError) as error:
        raise ConfigError(f"{where}: {error}") from error


def convert_fields(config: Any) -> None:
    """Convert the fields of a new dataclass to their types, as :func:`build` does.

    Raises:
        ConfigError: A value does not fit; names the field and the nearest valid value.
    """
    for name, hint in typing.get_type_hints(type(config)).items():
        object.__setattr__(config, name, _convert(hint, getattr(config, name), name))


def require_within(config: Any, **limits: tuple[float, float]) -> None:
    """Check that fields of a configuration lie within limits; None is always valid.

    Raises:
        ConfigError: One does not; names it, its value and the limits.
    """
    for name, (low, high) in limits.items():
        value = getattr(config, name)
        if value is not None and not low <= value <= high:
            raise ConfigError(f"{name} is {value:g}, valid are {low:g} to {high:g}")


def merged(base: Mapping[str, Any], top: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested tables with those of ``top`` over those of ``base``, key by key."""
    result = dict(base)
    for key, value in top.items():
        below = result.get(key)
        if isinstance(below, Mapping) and isinstance(value, Mapping):
            value = merged(below, value)
        result[key] = value
    return result


def to_mapping(value: Any) -> Any:
    """Return dataclasses as plain dictionaries (None left out), for manifests and digests."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        pairs = ((field.name, getattr(value, field.name)) for field in dataclasses.fields(value))
        return {name: to_mapping(item) for name, item in pairs if item is not None}
    if isinstance(value, tuple | list):
        return [to_mapping(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): to_mapping(item) for key, item in value.items()}
    return value


def to_toml(mapping: Mapping[str, Any]) -> str:
    """Return a table of values and of tables of values (no deeper) as TOML text."""
    plain = {key: value for key, value in mapping.items() if not isinstance(value, Mapping)}
    lines = [f"{key} = {json.dumps(value, allow_nan=False)}" for key, value in plain.items()]
    for key, table in mapping.items():
        if isinstance(table, Mapping):
            lines += ["", f"[{key}]", to_toml(table).rstrip()]
    return "\n".join(lines) + "\n"


def _convert(hint: Any, value: Any, where: str) -> Any:
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return _convert_union(parts, value, where)
    if origin is typing.Literal:
        return _convert_literal(parts, value, where)
    if origin is tuple:
        return _convert_tuple(parts, value, where)
    if dataclasses.is_dataclass(hint):
        if not isinstance(value, Mapping):
            raise ConfigError(f"{where}: expected a table, got {value!r}")
        return build(typing.cast(type, hint), value, where)
    return _convert_scalar(hint, value, where)


def _convert_union(options: tuple[Any, ...], value: Any, where: str) -> Any:
    if value is None and type(None) in options:
        return None
    *others, last = (option for option in options if option is not type(None))
    for option in others:
        with contextlib.suppress(ConfigError):
            return _convert(option, value, where)
    return _convert(last, value, where)


def _convert_literal(options: tuple[Any, ...], value: Any, where: str) -> Any:
    if value in options:
        return value
    names = [str(option) for option in options]
    raise ConfigError(
        f"{where}: {value!r} is not valid{nearest(str(value), names)} (valid: {', '.join(names)})"
    )


def _convert_tuple(items: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise ConfigError(f"{where}: expected a list, got {value!r}")
    if len(items) == 2 and items[1] is Ellipsis:
        items = (items[0],) * len(value)
    if len(items) != len(value):
        raise ConfigError(f"{where}: expected {len(items)} values, got {len(value)}")
    pairs = zip(items, value, strict=True)
    return tuple(_convert(item, got, f"{where}[{i}]") for i, (item, got) in enumerate(pairs))


def _convert_scalar(hint: Any, value: Any, where: str) -> Any:
    number: Any = Real if hint is float else Integral  # NumPy's too
    if hint in (int, float) and isinstance(value, number) and not isinstance(value, bool):
        if not abs(value) <= LARGEST:  # no comparison holds for NaN
            raise ConfigError(f"{where}: the number is not finite, or beyond {LARGEST:g}")
        return hint(value)
    if hint is Any or (hint in (str, bool) and isinstance(value, hint)):
        return value
    if (hint is dict or typing.get_origin(hint) is dict) and isinstance(value, Mapping):
        return dict(value)
    raise ConfigError(
        f"{where}: expected {getattr(hint, '__name__', hint)}, got {value!r} "
        f"({type(value).__name__})"
    )
