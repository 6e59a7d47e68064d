"""The parts of a sensor, put together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

from spikingtac_hardware.layout import Layout
from spikingtac_hardware.solids import bought, housing, tools
from spikingtac_hardware.solids.cad import Solid
from spikingtac_hardware.solids.shapes import common_volume_mm3

Made = Literal["printed", "bought", "cut", "cast", "tool"]

TOUCHING_MM3 = 1e-4
"""Common volume below which two parts only touch, mm³ (rounding of the modeller)."""


@dataclass(frozen=True, slots=True)
class Part:
    """One part in its place.

    Attributes:
        name: Its name, also of its files.
        made: ``printed``, ``bought``, ``cut`` from sheet, ``cast``, or ``tool`` (printed, and no
            part of the sensor).
        solid: Its solid, mm.
    """

    name: str
    made: Made
    solid: Solid


_SENSOR: tuple[tuple[str, Made, Callable[[Layout], Solid]], ...] = (
    ("screws", "bought", bought.screws),
    ("base", "printed", housing.base),
    ("connector", "bought", bought.connector),
    ("camera-board", "bought", bought.camera_board),
    ("event-sensor", "bought", bought.package),
    ("lens-holder", "bought", bought.lens_holder),
    ("lens", "bought", bought.lens),
    ("led-board", "bought", housing.led_board),
    ("leds", "bought", bought.leds),
    ("shading-plate", "printed", housing.plate),
    ("inserts", "bought", bought.inserts),
    ("shell", "printed", housing.shell),
    ("window", "cut", bought.window),
    ("gel", "cast", bought.gel),
    ("discs", "cast", bought.discs),
    ("cover", "cast", bought.cover),
)
"""The parts from below to above: name, kind, function."""

_TOOLS: tuple[tuple[str, Callable[[Layout], Solid]], ...] = (
    ("mould-tray", tools.tray),
    ("mould-lid", tools.lid),
    ("holder-2f85", tools.gripper_holder),
    ("holder-iso-flange", tools.flange_holder),
)


def sensor_parts(layout: Layout) -> tuple[Part, ...]:
    """Return the parts of the sensor from below to above, each in its place."""
    return tuple(Part(name, made, solid(layout)) for name, made, solid in _SENSOR)


def tool_parts(layout: Layout) -> tuple[Part, ...]:
    """Return mould and holders; the holders stand where they carry the sensor."""
    return tuple(Part(name, "tool", solid(layout)) for name, solid in _TOOLS)


def interferences(parts: tuple[Part, ...]) -> dict[tuple[str, str], float]:
    """Return the common volume of each pair of parts that overlap, mm³."""
    found = {}
    for one, other in combinations(parts, 2):
        volume = common_volume_mm3(one.solid, other.solid)
        if volume > TOUCHING_MM3:
            found[one.name, other.name] = volume
    return found
