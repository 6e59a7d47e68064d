"""A design: all parameters of one sensor, from a strict TOML file."""

from __future__ import annotations

import importlib.resources
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikingtac.errors import ConfigError, nearest
from spikingtac.schema import build, merged, read_toml
from spikingtac_hardware.parameters.housing import (
    Fasteners,
    Holders,
    Housing,
    Materials,
    Mould,
    Printing,
)
from spikingtac_hardware.parameters.inside import Board, Lens, Light, Sensor, Skin, Window

DEFAULT = "paper-size"
"""Name of the design of the paper's size."""
BASED_ON = "based_on"
"""Key of a TOML file that names the design whose values hold where the file has none."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Design:
    """One sensor.

    Attributes:
        about: Description in one line.
        housing: Base, shading plate and shell.
        skin: Gel, discs and cover.
        window: Acrylic window.
        sensor: Event sensor.
        lens: Lens.
        board: Camera board.
        light: LEDs.
        fasteners: Screws and inserts.
        printing: Process of the printed parts.
        materials: Densities and prices.
        mould: Tray and lid.
        holders: What carries the sensor.
    """

    about: str
    housing: Housing
    skin: Skin
    window: Window
    sensor: Sensor
    lens: Lens
    board: Board
    light: Light
    fasteners: Fasteners
    printing: Printing
    materials: Materials
    mould: Mould
    holders: Holders

    def __post_init__(self) -> None:
        if self.housing.outline != self.skin.outline:
            raise ValueError(
                f"the housing is {self.housing.outline!r} and the skin {self.skin.outline!r}; "
                "give both the same outline"
            )


def names() -> tuple[str, ...]:
    """Return the names of the designs of the package, the default one first."""
    stored = sorted(path.stem for path in _folder().glob("*.toml"))
    return (DEFAULT, *(name for name in stored if name != DEFAULT))


def descriptions() -> dict[str, str]:
    """Return the description of each design of the package by name."""
    return {name: str(read_toml(_path(name)).get("about", "")) for name in names()}


def load_design(name: str | Path = DEFAULT) -> Design:
    """Return a design of the package by name, or one from a TOML file.

    Args:
        name: Name of a design, or path of a TOML file. A file may hold a few keys only, and name
            the design that gives the others with ``based_on``.

    Example:
        >>> load_design().skin.grid
        (8, 8)

    Raises:
        ConfigError: No such name or file exists, or a key or value does not fit. The message names
            the nearest design, or the key and its valid values.
    """
    return build(Design, _values(name, ()), str(name))


def _values(name: str | Path, above: tuple[str, ...]) -> dict[str, Any]:
    values = read_toml(_located(str(name), above))
    base = values.pop(BASED_ON, None)
    if base is None:
        return values
    if not isinstance(base, str):
        raise ConfigError(f"{name}.{BASED_ON}: expected the name of a design, got {base!r}")
    if base in above:
        raise ConfigError(f"{name}.{BASED_ON}: {base!r} is based on itself")
    below: Mapping[str, Any] = _values(base, (*above, str(name)))
    return merged(below, values)


def _located(text: str, above: tuple[str, ...]) -> Path:
    if text in names():
        return _path(text)
    if not text.endswith(".toml") and os.sep not in text:
        where = f" (named by {above[-1]!r})" if above else ""
        raise ConfigError(
            f"no design {text!r}{where}{nearest(text, names())} "
            f"(valid: {', '.join(names())}, or the path of a TOML file)"
        )
    return Path(text)


def _path(name: str) -> Path:
    return _folder() / f"{name}.toml"


def _folder() -> Path:
    return Path(str(importlib.resources.files("spikingtac_hardware") / "designs"))
