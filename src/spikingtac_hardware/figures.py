"""The figures of a design, its bill of materials, and the build guide with both."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from spikingtac_hardware.design import DESIGNS, Design
from spikingtac_hardware.layout import Layout
from spikingtac_hardware.optics import Imaging, light_figures

MM3_PER_CM3 = 1000.0

# Densities: steel, brass, glass-fibre board, packages and glass, g/cm³ (textbook).
STEEL_G_CM3, BRASS_G_CM3, BOARD_G_CM3, PARTS_G_CM3 = 7.9, 8.5, 1.9, 2.3
SHARP_PX = 1.0  # Blur disc up to which the skin counts as sharp, px.
SEARCH_MM = np.linspace(0.0, 5.0, 501)  # Indentations at which sharpness is looked up, mm.

# Columns of the bill. Mass (g) and cost (dollars) are those of all pieces of an item.
COLUMNS = ("item", "quantity", "made", "material", "mass_g", "cost_usd")
Item = tuple[str, int, str, str, float, float]
PRINTED = ("base", "shading-plate", "shell")


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
    sensed = [min(s, f) for s, f in zip(skin.size_mm, field, strict=True)]
    area = math.prod(sensed) * (math.pi / 4 if layout.window.kind == "round" else 1.0)
    volume = layout.outer.area_mm2 * design.housing.height_mm
    sharp = [press for press in SEARCH_MM if imaging.blur_px(press) <= SHARP_PX]
    reach = np.array([layout.disc_reach_mm])
    distortion = imaging.image_px(reach)[0] / (reach[0] * imaging.px_per_mm) - 1
    return {
        "size_mm": [*layout.outer.size_mm, design.housing.height_mm],
        "volume_mm3": volume,
        "sensing_area_mm": sensed,
        "sensing_area_mm2": area,
        "depth_over_area_mm": volume / area,
        "markers": math.prod(skin.grid),
        "px_per_mm": imaging.px_per_mm,
        "pitch_px": skin.pitch_mm * imaging.px_per_mm,
        "disc_radius_px": skin.disc_diameter_mm / 2 * imaging.px_per_mm,
        "field_mm": list(field),
        "magnification": imaging.magnification,
        "working_distance_mm": layout.disc_mm - layout.lens_front_mm,
        "reduced_distance_mm": imaging.reduced_mm,
        "corner_angle_deg": imaging.corner_angle_deg,
        "distortion_at_outer_disc": float(distortion),
        "blur_at_deepest_press_px": imaging.blur_px(skin.deepest_press_mm),
        "sharp_to_indentation_mm": float(max(sharp)),
        "twin_lens": imaging.twin_lens(),
        **light_figures(layout, imaging),
    }


def bill_of_materials(design: Design, volume_mm3: Mapping[str, float]) -> list[Item]:
    """Return the bill of one sensor, without mould and holders, as rows of :data:`COLUMNS`.

    Args:
        design: The design; its prices are estimates, none is a quote.
        volume_mm3: Volumes of the parts by their names, mm³.
    """
    printing, material, light = design.printing, design.materials, design.light
    screws, sensor, lens = design.fasteners, design.sensor, design.lens

    def grams(density_g_cm3: float, *names: str) -> float:
        return sum(volume_mm3[name] / MM3_PER_CM3 * density_g_cm3 for name in names)

    price, mass = printing.price_usd_cm3 / MM3_PER_CM3, printing.density_g_cm3
    rows = [
        (name, 1, "printed", printing.process, grams(mass, name), volume_mm3[name] * price)
        for name in PRINTED
    ]
    pane, ink = f"acrylic, {design.window.thickness_mm:g} mm", f"{design.skin.paint} silicone ink"
    gel, discs, cover = (grams(material.silicone_g_cm3, name) for name in ("gel", "discs", "cover"))
    price, casting = material.silicone_usd_g, f"{cover_color(design)} silicone"
    window = grams(material.acrylic_g_cm3, "window")
    rows += [
        ("window", 1, "cut", pane, window, material.acrylic_usd),
        ("gel", 1, "cast", "clear platinum-cured silicone", gel, gel * price),
        ("discs", math.prod(design.skin.grid), "cast", ink, discs, material.paint_usd),
        ("cover", 1, "cast", casting, cover, cover * price),
    ]
    chip = "{}, {} x {} px".format(sensor.name, *sensor.pixels)
    screw = f"ISO 4762 M{screws.thread_mm:g} x {screws.length_mm:g}, steel"
    insert = f"M{screws.thread_mm:g} x {screws.insert_length_mm:g}, brass"
    board = grams(BOARD_G_CM3, "camera-board", "connector")
    driver = f"{light.leds} white LEDs, constant-current driver"
    leds = grams(BOARD_G_CM3, "led-board") + grams(PARTS_G_CM3, "leds")
    optics = grams(PARTS_G_CM3, "lens", "lens-holder")
    bought = [
        ("event sensor", 1, chip, grams(PARTS_G_CM3, "event-sensor"), sensor.cost_usd),
        ("lens with holder", 1, lens.name, optics, lens.cost_usd),
        ("camera board", 1, "board, regulators, connector", board, design.board.cost_usd),
        ("LED board", 1, driver, leds, light.cost_usd),
        ("screws", 4, screw, grams(STEEL_G_CM3, "screws"), 4 * material.screw_usd),
        ("heat-set inserts", 4, insert, grams(BRASS_G_CM3, "inserts"), 4 * material.insert_usd),
        ("cable", 1, "flat cable, outside", 0.0, material.cable_usd),
        ("reader board", 1, "microcontroller, outside", 0.0, material.reader_usd),
    ]
    return rows + [(name, n, "bought", what, mass, cost) for name, n, what, mass, cost in bought]


def totals(bill: Sequence[Item]) -> tuple[float, float]:
    """Return mass (g) and cost (dollars) of a bill."""
    return sum(item[4] for item in bill), sum(item[5] for item in bill)


def as_csv(bill: Sequence[Item]) -> str:
    """Return the bill as CSV with a line of totals."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for *words, mass, cost in (*bill, ("total", "", "", "", *totals(bill))):
        writer.writerow([*words, f"{mass:.3f}", f"{cost:.2f}"])
    return text.getvalue()


def build_guide(layout: Layout, figures: dict[str, Any], bill: Sequence[Item]) -> str:
    """Return the build guide.

    Args:
        layout: Heights and places.
        figures: From :func:`figures_of`.
        bill: From :func:`bill_of_materials`.
    """
    design, fasteners = layout.design, layout.design.fasteners
    mass_g, cost_usd = totals(bill)
    mass_of = {item[0]: item[4] for item in bill}
    text = (DESIGNS / "build-guide.md").read_text(encoding="utf-8")
    return text.format(
        design=design,
        figures=figures,
        mass_g=mass_g,
        cost_usd=cost_usd,
        gel_g=mass_of["gel"],
        cover_g=mass_of["cover"],
        cover_color=cover_color(design),
        rim=layout.outer.half_mm[0] - layout.pocket.half_mm[0],
        free=layout.disc_mm - layout.shell_top_mm,
        in_air=figures["reduced_distance_mm"] - design.lens.pupil_mm,
        engaged=fasteners.length_mm - layout.plate_top_mm + fasteners.counterbore_mm,
        distortion=-100 * figures["distortion_at_outer_disc"],
    )


def cover_color(design: Design) -> str:
    """Return the colour of the cover: the ground of its discs."""
    return "black" if design.skin.paint == "white" else "white"
