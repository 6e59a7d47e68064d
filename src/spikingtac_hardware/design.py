"""A design: the parameters of one sensor, from TOML; ``designs/paper-size.toml`` has them all.

That file holds every key with a value, a unit in its name and a source; every other design changes
some of its values. A key that it does not have, or a value of another type, is refused.
"""

from __future__ import annotations

import importlib.resources
import math
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from spikingtac.errors import ConfigError, nearest
from spikingtac.schema import merged, read_toml, stored_file, to_toml

DEFAULT = "paper-size"
BASED_ON = "based_on"  # key of the design whose values hold where a file has none
DESIGNS = Path(str(importlib.resources.files("spikingtac_hardware") / "designs"))
CHOICES = {"outline": ("rectangle", "round"), "paint": ("white", "dark")}

# Key -> least value, and what it must be below; all other numbers lie in the last range.
RANGES = {
    "contrast": (1.0, 1e3),
    "gel_index": (1.0, 10.0),
    "index": (1.0, 10.0),
    "half_angle_deg": (1.0, 90.0),
    "distortion_angle_deg": (1.0, 90.0),
    "distortion": (-1.0, 1.0),  # a barrel's is negative
}
ORDINARY = (1e-6, 1e6)
ANY_LENGTH = ("lengths_mm",)


class Design:
    """One sensor: tables ``housing``, ``skin``, ``window``, ``sensor``, ``lens``, and others.

    Attributes:
        values: What the TOML file holds; each table is an attribute, its lists are tuples.
    """

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.values = dict(values)

    def __getattr__(self, name: str) -> Any:
        """Return a table, or a value that stands in none."""
        if name == "values" or name not in self.values:
            raise AttributeError(name)
        value = self.values[name]
        if not isinstance(value, Mapping):
            return value
        plain = {key: tuple(one) if isinstance(one, list) else one for key, one in value.items()}
        return SimpleNamespace(**plain)

    def __eq__(self, other: object) -> bool:
        """Return whether both hold the same values."""
        return isinstance(other, Design) and self.values == other.values

    __hash__ = None  # type: ignore[assignment]

    def changed(self, **tables: Mapping[str, Any]) -> Design:
        """Return the design with other values, as ``skin={"gel_mm": 2.0}``.

        Raises:
            ConfigError: There is no such key, or a value does not fit.
        """
        return _checked(merged(self.values, tables), "design")

    @property
    def lens_k1(self) -> float:
        """Brown's first radial coefficient in the tangent of the view angle, in air."""
        return self.lens.distortion / math.tan(math.radians(self.lens.distortion_angle_deg)) ** 2

    def toml(self) -> str:
        """Return the design as TOML."""
        return to_toml(self.values)


def names() -> tuple[str, ...]:
    """Return the names of the designs of the package, the default one first."""
    stored = sorted(path.stem for path in DESIGNS.glob("*.toml"))
    return (DEFAULT, *(name for name in stored if name != DEFAULT))


def descriptions() -> dict[str, str]:
    """Return the description of each design of the package by name."""
    return {name: str(read_toml(DESIGNS / f"{name}.toml").get("about", "")) for name in names()}


def load_design(name: str | Path = DEFAULT) -> Design:
    """Return a design of the package by name, or one from a TOML file.

    Args:
        name: Name of a design, or path of a TOML file. A file may hold a few keys only; the design
            that it is ``based_on`` gives the others, the default one unless it says so.

    Example:
        >>> load_design().skin.grid
        (8, 8)

    Raises:
        ConfigError: No such name or file exists, or a key or value does not fit. The message names
            the nearest design, or the key and its valid values.
    """
    return _checked(_values(str(name), ()), str(name))


def _values(name: str, above: tuple[str, ...]) -> dict[str, Any]:
    kind = f"design (named by {above[-1]!r})" if above else "design"
    values = read_toml(stored_file(name, DESIGNS, names(), kind))
    if name == DEFAULT:
        return values
    base = values.pop(BASED_ON, DEFAULT)
    if not isinstance(base, str):
        raise ConfigError(f"{name}.{BASED_ON}: expected the name of a design, got {base!r}")
    if base in above:
        raise ConfigError(f"{name}.{BASED_ON}: {base!r} is based on itself")
    return merged(_values(base, (*above, name)), values)


def _checked(values: dict[str, Any], where: str) -> Design:
    """Return the design of some values, compared with those of the default one."""
    _compare(read_toml(DESIGNS / f"{DEFAULT}.toml"), values, where)
    housing, skin, leds = values["housing"], values["skin"], values["light"]["leds"]
    if housing["outline"] != skin["outline"]:
        outlines = housing["outline"], skin["outline"]
        raise ConfigError(f"{where}: housing and skin are {outlines}; give both the same outline")
    for table in (housing, skin):
        if table["outline"] == "round" and table["size_mm"][0] != table["size_mm"][1]:
            size_mm = list(table["size_mm"])
            raise ConfigError(f"{where}: size_mm is {size_mm}: a round one has one diameter twice")
    if leds % 4:
        raise ConfigError(f"{where}: leds is {leds}, not a multiple of 4")
    return Design(values)


def _compare(known: Mapping[str, Any], given: Mapping[str, Any], where: str) -> None:
    """Refuse keys and values that the default design has not, table by table."""
    for key, value in given.items():
        place = f"{where}.{key}"
        if key not in known:
            valid = ", ".join(sorted(known))
            raise ConfigError(f"{where}: unknown key {key!r}{nearest(key, known)} (valid: {valid})")
        if not isinstance(known[key], Mapping):
            _compare_value(known[key], value, place)
        elif isinstance(value, Mapping):
            _compare(known[key], value, place)
        else:
            raise ConfigError(f"{place}: expected a table, got {value!r}")


def _compare_value(known: Any, value: Any, place: str) -> None:
    key = place.rpartition(".")[2]
    models = known if isinstance(known, list) else [known]
    parts = value if isinstance(value, list | tuple) else [value]
    number = isinstance(models[0], int | float)
    whole = all(isinstance(model, int) for model in models) and key not in ANY_LENGTH
    kind = int if whole else int | float if number else str
    alike = all(isinstance(item, kind) and not isinstance(item, bool) for item in parts)
    if isinstance(known, list) != isinstance(value, list | tuple) or not alike:
        raise ConfigError(f"{place}: expected a value like {known!r}, got {value!r}")
    if len(parts) != len(models) and key not in ANY_LENGTH:
        raise ConfigError(f"{place}: expected {len(models)} values, got {value!r}")
    if value not in CHOICES.get(key, (value,)):
        raise ConfigError(f"{place}: {value!r} (valid: {', '.join(CHOICES[key])})")
    low, high = RANGES.get(key, ORDINARY)
    for item in parts if number else ():
        if not low <= item < high:
            raise ConfigError(f"{place} is {item:g}, valid is {low:g} to below {high:g}")
