"""Checks: every stored design passes, and each wrong parameter gets its own reason."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from spikingtac.errors import ConfigError
from spikingtac_hardware.checks.check import check_design, require_sound
from spikingtac_hardware.checks.finding import least, most
from spikingtac_hardware.layout import Layout
from spikingtac_hardware.parameters.design import Design, load_design, names


def changed(part: str, **values: Any) -> Design:
    design = load_design()
    return replace(design, **{part: replace(getattr(design, part), **values)})


def failed(design: Design) -> set[str]:
    return {finding.name for finding in check_design(design) if not finding.passed}


@pytest.mark.parametrize("name", names())
def test_every_stored_design_passes(name: str) -> None:
    assert failed(load_design(name)) == set()
    assert len(check_design(load_design(name))) == len(check_design(load_design()))


def test_the_paper_s_size() -> None:
    design = load_design()
    assert (*design.housing.size_mm, design.housing.height_mm) == (22.0, 22.0, 19.0)
    assert design.skin.size_mm == (20.6, 20.6)
    layout = Layout(design)
    assert layout.disc_mm + design.skin.cover_mm == 19.0


def test_a_thick_gel_gets_the_reason_in_words() -> None:
    with pytest.raises(
        ConfigError, match=r"the gel of 8.65 mm leaves 0.4 mm to the lens; needed 1.0"
    ):
        require_sound(changed("skin", gel_mm=8.65))


def test_a_lens_in_the_window_is_told_without_optics() -> None:
    findings = check_design(changed("skin", gel_mm=12.0))
    assert {"lens.gap"} <= {finding.name for finding in findings if not finding.passed}
    assert not any(finding.name.startswith("rays") for finding in findings)


@pytest.mark.parametrize(
    ("part", "values", "name"),
    [
        ("housing", {"size_mm": (21.6, 22.0)}, "shell.rim"),
        ("housing", {"wall_mm": 0.4}, "shell.wall"),
        ("housing", {"floor_mm": 0.5}, "base.floor"),
        ("housing", {"plate_mm": 1.2}, "plate.roof"),
        ("housing", {"ledge_mm": 0.8}, "window.ledge"),
        ("housing", {"ledge_mm": 2.6}, "rays.ledge.x"),
        ("housing", {"rim_mm": 2.1}, "skin.free"),
        ("housing", {"height_mm": 17.5}, "shell.height"),
        ("housing", {"cable_mm": (9.0, 1.2)}, "board.cable"),
        ("housing", {"baffle_mm": 2.0}, "rays.baffle"),
        ("housing", {"base_mm": 4.9}, "holder.height"),
        ("window", {"clearance_mm": 0.02}, "window.clearance"),
        ("window", {"clearance_mm": 0.2}, "shell.rim"),
        ("fasteners", {"inset_mm": 2.2}, "base.counterbore"),
        ("fasteners", {"inset_mm": 1.8}, "shell.insert"),
        ("fasteners", {"inset_mm": 4.0}, "base.cavity"),
        ("fasteners", {"head_mm": (3.0, 2.0)}, "screw.head"),
        ("fasteners", {"length_mm": 7.0}, "screw.length"),
        ("fasteners", {"length_mm": 6.0}, "screw.engagement"),
        ("fasteners", {"length_mm": 10.0}, "screw.tip"),
        ("fasteners", {"holder_length_mm": 10.0}, "holder screw.engagement"),
        ("fasteners", {"holder_length_mm": 16.0}, "holder screw.tip"),
        ("fasteners", {"insert_hole_depth_mm": 3.1}, "insert.hole"),
        ("board", {"size_mm": (21.0, 21.0)}, "board.wall"),
        ("board", {"chamfer_mm": 6.0}, "board.posts"),
        ("board", {"holder_mm": (5.5, 2.1)}, "holder.width"),
        ("light", {"place_mm": 6.0}, "leds.inside"),
        ("light", {"place_mm": 8.9}, "leds.outside"),
        ("light", {"spread_mm": 6.5}, "leds.screws"),
        ("light", {"spread_mm": 5.6}, "leds.web"),
        ("light", {"led_mm": (2.0, 1.25, 1.3)}, "leds.below"),
        ("light", {"current_ma": 25.0}, "leds.current"),
        ("light", {"supply_v": 3.0}, "leds.supply"),
        ("light", {"intensity_mcd": 200.0}, "light.skin"),
        ("light", {"place_mm": 3.0}, "light.uniformity"),
        ("light", {"supply_v": 24.0}, "heat"),
        ("sensor", {"pixels": (280, 320)}, "field.x"),
        ("sensor", {"pixels": (320, 280)}, "field.y"),
        ("lens", {"half_angle_deg": 55.0}, "lens.angle"),
        ("lens", {"image_circle_mm": 2.7}, "lens.circle"),
        ("lens", {"f_number": 1.4}, "lens.blur"),
        ("skin", {"disc_diameter_mm": 0.5}, "disc.radius"),
        ("skin", {"disc_diameter_mm": 1.7}, "disc.pitch"),
        ("skin", {"pitch_mm": 2.8}, "disc.margin"),
        ("skin", {"pitch_mm": 2.83}, "disc.inside"),
    ],
)  # fmt: skip
def test_a_wrong_parameter_fails_its_check(part: str, values: dict[str, Any], name: str) -> None:
    assert name in failed(changed(part, **values))


def test_the_rim_about_the_lens_hides_the_leds() -> None:
    low = changed("housing", baffle_mm=0.1)
    shadow = {finding.name: finding.value for finding in check_design(low)}["light.baffle"]
    assert shadow < {f.name: f.value for f in check_design(load_design())}["light.baffle"]


def test_findings_say_value_and_limit() -> None:
    assert least("a", "the wall is", 0.5, 0.6).reason == "the wall is 0.5 mm; needed 0.6"
    assert most("a", "it warms by", 120.0, 15.0, "K").reason == "it warms by 120 K; allowed 15"
    assert least("a", "b", 1.0, 1.0).passed
    assert not most("a", "b", 1.1, 1.0).passed


def test_every_failure_is_listed() -> None:
    with pytest.raises(ConfigError) as error:
        require_sound(changed("housing", wall_mm=0.4, floor_mm=0.5))
    assert "shell.wall: the shell's wall is 0.4 mm; needed 0.6" in str(error.value)
    assert "base.floor" in str(error.value)
