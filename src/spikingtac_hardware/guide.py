"""The build guide: a page in Markdown with the figures of the design."""

from __future__ import annotations

import importlib.resources
from typing import Any

from spikingtac_hardware.bill import Item, totals
from spikingtac_hardware.layout import Layout

INSERT_C = 220
"""Temperature of the iron for brass inserts in PA12, degrees Celsius (class)."""


def build_guide(layout: Layout, figures: dict[str, Any], bill: tuple[Item, ...]) -> str:
    """Return the build guide.

    Args:
        layout: Heights and places.
        figures: From :func:`spikingtac_hardware.figures.figures_of`.
        bill: From :func:`spikingtac_hardware.bill.bill_of_materials`.
    """
    design = layout.design
    mass_g, cost_usd = totals(bill)
    mass_of = {item.item: item.mass_g for item in bill}
    rim = layout.outer.half_mm[0] - layout.pocket.half_mm[0]
    plain = layout.plate_top_mm - design.fasteners.counterbore_mm
    in_air = figures["reduced_distance_mm"] - design.lens.pupil_mm
    page = importlib.resources.files("spikingtac_hardware") / "designs" / "build-guide.md"
    return page.read_text(encoding="utf-8").format(
        about=design.about, width=layout.outer.size_mm[0], depth=layout.outer.size_mm[1],
        height=design.housing.height_mm, mass=mass_g, cost=cost_usd,
        process=design.printing.process, rim=rim,
        window=design.window.thickness_mm, rows=design.skin.grid[0],
        columns=design.skin.grid[1], disc=design.skin.disc_diameter_mm,
        pitch=design.skin.pitch_mm, paint=design.skin.paint, gel_g=mass_of["gel"],
        gel=design.skin.gel_mm, cover_g=mass_of["cover"], cover=design.skin.cover_mm,
        cover_color="black" if design.skin.paint == "white" else "white",
        free=layout.disc_mm - layout.shell_top_mm, thread=design.fasteners.thread_mm,
        insert=design.fasteners.insert_length_mm, insert_c=INSERT_C,
        current=design.light.current_ma, supply=figures["supply_ma"],
        volts=design.light.supply_v, reduced_front=in_air,
        working=figures["working_distance_mm"],
        length=design.fasteners.length_mm, engaged=design.fasteners.length_mm - plain,
        holder_length=design.fasteners.holder_length_mm, px_per_mm=figures["px_per_mm"],
        pitch_px=figures["pitch_px"], disc_px=figures["disc_radius_px"],
        field_x=figures["field_mm"][0], field_y=figures["field_mm"][1],
        distortion=-100 * figures["distortion_at_outer_disc"], lux=figures["centre_lux"],
        warming=figures["warming_k"],
    )  # fmt: skip
