"""The figures of a design, its bill of materials, and the build guide with both."""

from __future__ import annotations

import csv
import importlib.resources
import io
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from spikingtac_hardware.design import Design
from spikingtac_hardware.layout import Layout
from spikingtac_hardware.light import light_figures
from spikingtac_hardware.optics import Imaging

MM3_PER_CM3 = 1000.0

# Densities: steel, brass, glass-fibre board, packages and glass, g/cm³ (textbook).
STEEL_G_CM3, BRASS_G_CM3, BOARD_G_CM3, PARTS_G_CM3 = 7.9, 8.5, 1.9, 2.3
SHARP_PX = 1.0  # Blur disc up to which the skin counts as sharp, px.
SEARCH_MM = np.linspace(0.0, 5.0, 501)  # Indentations at which sharpness is looked up, mm.


def figures_of(design: Design) -> dict[str, Any]:
    """Return what follows from the parameters of a design that passes its checks.

    Example:
        >>> from spikingtac_hardware.design import load_design
        >>> round(figures_of(load_design())["pitch_px"], 1)
        37.2
    """
    layout = Layout(design)
    imaging = Imaging(layout)
    skin, field = design.skin, imaging.field_mm
    area = _sensing_area_mm2(layout, field)
    width, depth = layout.outer.size_mm
    volume = layout.outer.area_mm2 * design.housing.height_mm
    sharp = [press for press in SEARCH_MM if imaging.blur_px(press) <= SHARP_PX]
    return {
        "size_mm": [width, depth, design.housing.height_mm],
        "volume_mm3": volume,
        "sensing_area_mm": [min(s, f) for s, f in zip(skin.size_mm, field, strict=True)],
        "sensing_area_mm2": area,
        "depth_over_area_mm": volume / area,
        "markers": skin.grid[0] * skin.grid[1],
        "px_per_mm": imaging.px_per_mm,
        "pitch_px": skin.pitch_mm * imaging.px_per_mm,
        "disc_radius_px": skin.disc_diameter_mm / 2 * imaging.px_per_mm,
        "field_mm": list(field),
        "magnification": imaging.magnification,
        "working_distance_mm": layout.disc_mm - layout.lens_front_mm,
        "reduced_distance_mm": imaging.reduced_mm,
        "corner_angle_deg": imaging.corner_angle_deg,
        "distortion_at_outer_disc": _distortion(layout, imaging),
        "blur_at_deepest_press_px": imaging.blur_px(skin.deepest_press_mm),
        "sharp_to_indentation_mm": float(max(sharp)),
        "twin_lens": asdict(imaging.twin_lens()),
        **asdict(light_figures(layout, imaging)),
    }


def _sensing_area_mm2(layout: Layout, field_mm: tuple[float, float]) -> float:
    """Return the area of the skin that the sensor sees, a rectangle or a circle."""
    width, depth = (min(s, f) for s, f in zip(layout.window.size_mm, field_mm, strict=True))
    return float(np.pi / 4 * width * depth) if layout.window.kind == "round" else width * depth


def _distortion(layout: Layout, imaging: Imaging) -> float:
    reach = np.array([layout.disc_reach_mm])
    return float(imaging.image_px(reach)[0] / (reach[0] * imaging.px_per_mm) - 1)


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
    return [
        Item("window", 1, "cut", f"acrylic, {design.window.thickness_mm:g} mm",
             cm3["window"] * material.acrylic_g_cm3, material.acrylic_usd),
        Item("gel", 1, "cast", "clear platinum-cured silicone", gel, gel * material.silicone_usd_g),
        Item("discs", skin.grid[0] * skin.grid[1], "cast", f"{skin.paint} silicone ink", discs,
             material.paint_usd),
        Item("cover", 1, "cast", f"{_cover_color(design)} silicone", cover,
             cover * material.silicone_usd_g),
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


def build_guide(layout: Layout, figures: dict[str, Any], bill: tuple[Item, ...]) -> str:
    """Return the build guide.

    Args:
        layout: Heights and places.
        figures: From :func:`figures_of`.
        bill: From :func:`bill_of_materials`.
    """
    design, fasteners = layout.design, layout.design.fasteners
    mass_g, cost_usd = totals(bill)
    mass_of = {item.item: item.mass_g for item in bill}
    page = importlib.resources.files("spikingtac_hardware") / "designs" / "build-guide.md"
    return page.read_text(encoding="utf-8").format(
        design=design,
        figures=figures,
        mass_g=mass_g,
        cost_usd=cost_usd,
        gel_g=mass_of["gel"],
        cover_g=mass_of["cover"],
        cover_color=_cover_color(design),
        rim=layout.outer.half_mm[0] - layout.pocket.half_mm[0],
        free=layout.disc_mm - layout.shell_top_mm,
        in_air=figures["reduced_distance_mm"] - design.lens.pupil_mm,
        engaged=fasteners.length_mm - layout.plate_top_mm + fasteners.counterbore_mm,
        distortion=-100 * figures["distortion_at_outer_disc"],
    )


def _cover_color(design: Design) -> str:
    return "black" if design.skin.paint == "white" else "white"
