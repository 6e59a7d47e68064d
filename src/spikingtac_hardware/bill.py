"""The bill of materials: quantity, mass and cost of everything in one sensor."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, fields

from spikingtac_hardware.parameters.design import Design

MM3_PER_CM3 = 1000.0
STEEL_G_CM3, BRASS_G_CM3, BOARD_G_CM3, PARTS_G_CM3 = 7.9, 8.5, 1.9, 2.3
"""Densities: steel, brass, glass-fibre board, packages and glass, g/cm³ (textbook)."""


@dataclass(frozen=True, slots=True)
class Item:
    """One line of the bill.

    Attributes:
        item: What it is.
        quantity: How many.
        made: ``printed``, ``bought``, ``cut`` or ``cast``.
        material: Material, or name of the part.
        mass_g: Mass of all of them, g.
        cost_usd: Cost of all of them, dollars.
    """

    item: str
    quantity: int
    made: str
    material: str
    mass_g: float
    cost_usd: float


def bill_of_materials(design: Design, volume_mm3: Mapping[str, float]) -> tuple[Item, ...]:
    """Return the bill of one sensor, without mould and holders.

    Args:
        design: The design; its prices are estimates, none is a quote.
        volume_mm3: Volumes of the parts by their names, mm³.
    """
    cm3 = {name: volume / MM3_PER_CM3 for name, volume in volume_mm3.items()}
    return (*_printed(design, cm3), *_cast(design, cm3), *_bought(design, cm3))


def totals(bill: tuple[Item, ...]) -> tuple[float, float]:
    """Return mass (g) and cost (dollars) of a bill."""
    return sum(item.mass_g for item in bill), sum(item.cost_usd for item in bill)


def as_csv(bill: tuple[Item, ...]) -> str:
    """Return the bill as CSV with a line of totals."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(field.name for field in fields(Item))
    for one in bill:
        writer.writerow([one.item, one.quantity, one.made, one.material,
                         f"{one.mass_g:.3f}", f"{one.cost_usd:.2f}"])  # fmt: skip
    mass, cost = totals(bill)
    writer.writerow(["total", "", "", "", f"{mass:.3f}", f"{cost:.2f}"])
    return text.getvalue()


def _printed(design: Design, cm3: Mapping[str, float]) -> list[Item]:
    printing = design.printing
    return [
        Item(name, 1, "printed", printing.process, cm3[name] * printing.density_g_cm3,
             cm3[name] * printing.price_usd_cm3)
        for name in ("base", "shading-plate", "shell")
    ]  # fmt: skip


def _cast(design: Design, cm3: Mapping[str, float]) -> list[Item]:
    material, skin = design.materials, design.skin
    gel, cover = (cm3[name] * material.silicone_g_cm3 for name in ("gel", "cover"))
    discs = cm3["discs"] * material.silicone_g_cm3
    cover_color = "black" if skin.paint == "white" else "white"
    return [
        Item("window", 1, "cut", f"acrylic, {design.window.thickness_mm:g} mm",
             cm3["window"] * material.acrylic_g_cm3, material.acrylic_usd),
        Item("gel", 1, "cast", "clear platinum-cured silicone", gel, gel * material.silicone_usd_g),
        Item("discs", skin.grid[0] * skin.grid[1], "cast", f"{skin.paint} silicone ink", discs,
             material.paint_usd),
        Item("cover", 1, "cast", f"{cover_color} silicone", cover, cover * material.silicone_usd_g),
    ]  # fmt: skip


def _bought(design: Design, cm3: Mapping[str, float]) -> list[Item]:
    material, screws, light = design.materials, design.fasteners, design.light
    board = (cm3["camera-board"] + cm3["connector"]) * BOARD_G_CM3
    lens = (cm3["lens"] + cm3["lens-holder"]) * PARTS_G_CM3
    leds = cm3["led-board"] * BOARD_G_CM3 + cm3["leds"] * PARTS_G_CM3
    width, height = design.sensor.pixels
    return [
        Item("event sensor", 1, "bought", f"{design.sensor.name}, {width} x {height} px",
             cm3["event-sensor"] * PARTS_G_CM3, design.sensor.cost_usd),
        Item("lens with holder", 1, "bought", design.lens.name, lens, design.lens.cost_usd),
        Item("camera board", 1, "bought", "board, regulators, connector", board,
             design.board.cost_usd),
        Item("LED board", 1, "bought", f"{light.leds} white LEDs, constant-current driver", leds,
             light.cost_usd),
        Item("screws", 4, "bought",
             f"ISO 4762 M{screws.thread_mm:g} x {screws.length_mm:g}, steel",
             cm3["screws"] * STEEL_G_CM3, 4 * material.screw_usd),
        Item("heat-set inserts", 4, "bought",
             f"M{screws.thread_mm:g} x {screws.insert_length_mm:g}, brass",
             cm3["inserts"] * BRASS_G_CM3, 4 * material.insert_usd),
        Item("cable", 1, "bought", "flat cable, outside", 0.0, material.cable_usd),
        Item("reader board", 1, "bought", "microcontroller, outside", 0.0, material.reader_usd),
    ]  # fmt: skip
