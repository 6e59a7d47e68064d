"""Figures, the bill, the guide, and the paper's table of sensors."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import replace

import pytest

from spikingtac_hardware.bill import as_csv, bill_of_materials, totals
from spikingtac_hardware.figures import figures_of
from spikingtac_hardware.guide import build_guide
from spikingtac_hardware.layout import Layout
from spikingtac_hardware.parameters.design import load_design, names
from spikingtac_hardware.published import TABLE

PARTS = (
    "screws", "base", "connector", "camera-board", "event-sensor", "lens-holder", "lens",
    "led-board", "leds", "shading-plate", "inserts", "shell", "window", "gel", "discs", "cover",
)  # fmt: skip
VOLUMES = {name: 1000.0 for name in PARTS}


def test_figures_of_the_paper_s_size() -> None:
    figures = figures_of(load_design())
    assert figures["volume_mm3"] == 9196.0
    assert figures["sensing_area_mm"] == [20.6, 20.6]
    assert figures["depth_over_area_mm"] == pytest.approx(9196 / 424.36)
    assert figures["sharp_to_indentation_mm"] == pytest.approx(2.4, abs=0.02)
    assert figures["working_distance_mm"] == pytest.approx(18.5 - 7.45)


def test_a_round_skin_has_a_round_area() -> None:
    figures = figures_of(load_design("round-fingertip"))
    assert figures["sensing_area_mm2"] == pytest.approx(math.pi * 10.3**2)


def test_the_bill_adds_up() -> None:
    design = load_design()
    bill = bill_of_materials(design, VOLUMES)
    rows = list(csv.DictReader(io.StringIO(as_csv(bill))))
    mass, cost = totals(bill)
    assert float(rows[-1]["mass_g"]) == pytest.approx(mass, abs=1e-3)
    assert float(rows[-1]["cost_usd"]) == pytest.approx(cost, abs=0.01)
    of = {row["item"]: row for row in rows}
    assert float(of["shell"]["mass_g"]) == pytest.approx(design.printing.density_g_cm3)
    assert of["discs"]["quantity"] == "64"
    assert float(of["screws"]["cost_usd"]) == pytest.approx(4 * design.materials.screw_usd)


def test_a_dark_print_has_a_light_cover() -> None:
    bill = bill_of_materials(load_design("gelsight-like"), VOLUMES)
    material = {item.item: item.material for item in bill}
    assert material["cover"] == "white silicone"
    assert material["discs"] == "dark silicone ink"


@pytest.mark.parametrize("name", names())
def test_the_guide_is_of_its_design(name: str) -> None:
    design = load_design(name)
    bill = bill_of_materials(design, VOLUMES)
    guide = build_guide(Layout(design), figures_of(design), bill)
    assert design.about in guide
    assert "Nobody has built or measured this design" in guide
    assert f"M{design.fasteners.thread_mm:g} x {design.fasteners.length_mm:g} screws" in guide
    assert "{" not in guide


def test_every_cell_of_the_paper_s_table_follows_from_its_factors() -> None:
    assert {row.name: row.slips for row in TABLE if row.slips} == {}
    assert len(TABLE) == 7


def test_a_wrong_cell_is_found() -> None:
    ours = TABLE[-1]
    assert replace(ours, volume_mm3=9169).slips == ("volume: printed 9169, computed 9196.00",)
    assert replace(ours, ratio_mm=23).slips == ("ratio: printed 23, computed 21.67",)


def test_what_the_text_says_of_the_table() -> None:
    rows = {row.name: row for row in TABLE}
    share = rows["SpikingTac"].computed_volume_mm3 / rows["Evetac"].computed_volume_mm3
    assert round(100 * share) == 13
    assert min(rows.values(), key=lambda row: row.computed_ratio_mm).name == "SpikingTac"


def test_our_design_beside_the_printed_row() -> None:
    figures, printed = figures_of(load_design()), TABLE[-1]
    assert figures["volume_mm3"] == printed.volume_mm3
    assert figures["sensing_area_mm2"] == pytest.approx(printed.area_mm2)
    assert round(figures["depth_over_area_mm"]) == printed.ratio_mm
