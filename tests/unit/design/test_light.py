"""Light: the inverse-square law of a Lambertian source, shadows, current and heat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spikingtac_hardware.layout import Layout
from spikingtac_hardware.light import illuminance_lux, light_figures
from spikingtac_hardware.optics import Imaging
from spikingtac_hardware.parameters.design import Design, load_design


def lit(design: Design, places_mm: list[list[float]]) -> np.ndarray:
    layout = Layout(design)
    return illuminance_lux(layout, Imaging(layout), np.array(places_mm))


def test_the_middle_is_lit_by_every_led_alike() -> None:
    design = load_design()
    layout = Layout(design)
    x, y, _ = layout.led_places_mm[0]
    height = layout.window_bottom_mm - layout.led_top_mm + 2.0 / 1.49 + 2.5 / 1.41
    away2 = height**2 + x**2 + y**2
    candela = 0.350 * 4.0 / 20.0
    through = 1 - (0.49 / 2.49) ** 2
    wanted = 8 * candela * through * height**2 / away2**2 * 1e6
    assert lit(design, [[0.0, 0.0]])[0] == pytest.approx(wanted)


def test_light_is_proportional_to_the_current() -> None:
    design = load_design()
    twice = replace(design, light=replace(design.light, current_ma=8.0))
    places = [[0.0, 0.0], [5.0, -3.0]]
    assert lit(twice, places) == pytest.approx(2 * lit(design, places))


def test_light_is_symmetric() -> None:
    corners = [[x, y] for x in (-6.0, 6.0) for y in (-6.0, 6.0)]
    assert np.ptp(lit(load_design(), corners)) == pytest.approx(0.0, abs=1e-9)


def test_pillars_cast_shadows() -> None:
    design = load_design()
    slim = replace(design, fasteners=replace(design.fasteners, insert_wall_mm=0.01,
                                             insert_hole_mm=0.02))  # fmt: skip
    corner, middle = [[10.2, 10.2]], [[0.0, 0.0]]
    assert lit(slim, corner)[0] > 1.05 * lit(design, corner)[0]
    assert lit(slim, middle) == pytest.approx(lit(design, middle))


def test_current_and_heat() -> None:
    figures = light_figures(layout := Layout(load_design()), Imaging(layout))
    assert figures.supply_ma == 32.0
    assert figures.power_mw == pytest.approx(32.0 * 5.0 + 50.0)
    area_m2 = (4 * 22 * 19 + 22 * 22) * 1e-6
    assert figures.warming_k == pytest.approx((0.75 * 160 + 50) / 1000 / (10 * area_m2))


def test_a_lens_that_loses_nothing_leaves_the_lamps_alone() -> None:
    design = load_design()
    ideal = replace(design, lens=replace(design.lens, corner_light=1.0))
    first, second = (
        light_figures(layout := Layout(one), Imaging(layout)) for one in (design, ideal)
    )
    assert 0 <= second.vignetting < first.vignetting < 0.5
    assert second.sensor_lux == first.sensor_lux
