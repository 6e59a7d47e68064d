"""Designs from TOML, their checks, figures and bill, and the verb without the modeller."""

import csv
import io
import math
import sys
from pathlib import Path
from typing import Any

import pytest

from spikingtac.errors import ConfigError
from spikingtac_hardware.checks import check_design
from spikingtac_hardware.design import Design, descriptions, load_design, names
from spikingtac_hardware.figures import as_csv, bill_of_materials, build_guide, figures_of, totals
from spikingtac_hardware.layout import Layout
from spikingtac_hardware.parts import SENSOR
from stand_ins.verbs import Verbs

VOLUMES = {name: 1000.0 for name in SENSOR}


def written(folder: Path, text: str, name: str = "mine.toml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def failed(design: Design) -> set[str]:
    return {finding.name for finding in check_design(design) if not finding.passed}


@pytest.mark.parametrize("name", names())
def test_a_stored_design_says_what_it_is_passes_and_survives_its_own_file(
    name: str, tmp_path: Path
) -> None:
    design = load_design(name)
    assert descriptions()[name] == design.about
    assert failed(design) == set()
    assert load_design(written(tmp_path, design.toml())) == design
    guide = build_guide(Layout(design), figures_of(design), bill_of_materials(design, VOLUMES))
    assert design.about in guide
    assert "Nobody has built or measured this design" in guide
    assert f"M{design.fasteners.thread_mm:g} x {design.fasteners.length_mm:g} screws" in guide
    assert "{" not in guide


def test_a_file_changes_only_what_it_names_and_may_be_based_on_a_file(tmp_path: Path) -> None:
    first = written(tmp_path, "[skin]\ngel_mm = 2.0\n", "first.toml")
    second = written(tmp_path, f'based_on = "{first}"\n[skin]\ncover_mm = 0.4\n', "second.toml")
    skin = load_design(second).skin
    assert (skin.gel_mm, skin.cover_mm, skin.grid) == (2.0, 0.4, load_design().skin.grid)
    written(tmp_path, f'based_on = "{second}"\n', "first.toml")
    with pytest.raises(ConfigError, match="is based on itself"):
        load_design(first)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[skin]\ngell_mm = 2.0\n", "did you mean 'gel_mm'"),
        ("[skin]\ngel_mm = -1.0\n", "skin.gel_mm is -1, valid is 1e-06 to"),
        ('[skin]\ngel_mm = "2"\n', "expected a value like 2.5"),
        ("[skin]\ngrid = [8.5, 8]\n", "expected a value like"),
        ("skin = 3\n", "expected a table"),
        ("[skin]\ngel_index = 0.9\n", "skin.gel_index is 0.9, valid is 1 to below"),
        ("[light]\nleds = 6\n", "multiple of 4"),
        ('[housing]\noutline = "round"\n', "give both the same outline"),
        (
            '[housing]\noutline = "round"\n[skin]\noutline = "round"\nsize_mm = [20.0, 10.0]\n',
            "one diameter twice",
        ),
        ('based_on = "papersize"\n', "did you mean 'paper-size'"),
        ("based_on = 3\n", "expected the name of a design"),
    ],
)
def test_a_mistake_is_named(text: str, reason: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=reason):
        load_design(written(tmp_path, text))


def test_a_lens_in_the_window_is_told_without_optics() -> None:
    findings = check_design(load_design().changed(skin={"gel_mm": 12.0}))
    assert {"lens.gap"} <= {finding.name for finding in findings if not finding.passed}
    assert not any(finding.name.startswith("rays") for finding in findings)


@pytest.mark.parametrize(
    ("part", "values", "name"),
    [
        ("housing", {"size_mm": (21.6, 22.0)}, "shell.rim"),
        ("housing", {"ledge_mm": 2.6}, "rays.ledge.x"),
        ("housing", {"rim_mm": 2.1}, "skin.free"),
        ("fasteners", {"inset_mm": 1.8}, "shell.insert"),
        ("fasteners", {"inset_mm": 4.0}, "base.cavity"),
        ("fasteners", {"length_mm": 6.0}, "screw.engagement"),
        ("board", {"size_mm": (21.0, 21.0)}, "board.wall"),
        ("board", {"holder_mm": (5.5, 2.1)}, "holder.width"),
        ("light", {"spread_mm": 6.5}, "leds.screws"),
        ("light", {"intensity_mcd": 200.0}, "light.skin"),
        ("light", {"place_mm": 3.0}, "light.uniformity"),
        ("light", {"supply_v": 24.0}, "heat"),
        ("sensor", {"pixels": (280, 320)}, "field.x"),
        ("lens", {"f_number": 1.4}, "lens.blur"),
        ("skin", {"disc_diameter_mm": 0.5}, "disc.radius"),
        ("skin", {"pitch_mm": 2.8}, "disc.margin"),
    ],
)  # fmt: skip
def test_a_wrong_parameter_fails_its_check(part: str, values: dict[str, Any], name: str) -> None:
    assert name in failed(load_design().changed(**{part: values}))


def test_figures_of_the_paper_s_size() -> None:
    figures = figures_of(load_design())
    assert figures["size_mm"] == [22.0, 22.0, 19.0]
    assert figures["volume_mm3"] == 9196.0
    assert figures["sensing_area_mm"] == [20.6, 20.6]
    assert figures["depth_over_area_mm"] == pytest.approx(9196 / 424.36)
    assert figures["sharp_to_indentation_mm"] == pytest.approx(2.4, abs=0.02)
    assert figures["working_distance_mm"] == pytest.approx(18.5 - 7.45)
    round_area_mm2 = figures_of(load_design("round-fingertip"))["sensing_area_mm2"]
    assert round_area_mm2 == pytest.approx(math.pi * 10.3**2)


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


def test_the_verb_lists_shows_and_refuses(tmp_path: Path, verbs: Verbs) -> None:
    lines = verbs.said("design", "--list").splitlines()
    assert [line.partition("  ")[0] for line in lines] == list(names())
    found = verbs.told("design")
    assert found["design"] == "paper-size"
    assert all(check["passed"] for check in found["checks"])
    assert "checks passed" in verbs.said("design", "round-fingertip")
    bad = written(tmp_path, "[skin]\ngel_mm = 8.65\n")
    assert "the gel of 8.65 mm leaves 0.4 mm to the lens; needed 1.0" in verbs.said(
        "design", bad, code=2
    )


def test_files_need_the_extra_and_are_not_replaced_unasked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verbs: Verbs
) -> None:
    monkeypatch.setitem(sys.modules, "build123d", None)
    told = verbs.said("design", "-o", tmp_path / "sensor", code=3)
    assert "pip install 'spikingtac[design]'" in told
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "figures.json").write_text("{}")
    assert "--overwrite" in verbs.said("design", "-o", tmp_path, code=2)
