"""Solids, files and pictures; they need build123d, which the extra ``[design]`` brings."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from spikingtac_hardware.design import DEFAULT, load_design, names
from spikingtac_hardware.layout import Layout
from stand_ins.verbs import Verbs

REASON = "build123d is not installed; pip install 'spikingtac[design]' runs these tests"
cad = pytest.importorskip("build123d", reason=REASON)
checker = pytest.importorskip("trimesh", reason=REASON)

from spikingtac.errors import ConfigError  # noqa: E402
from spikingtac_hardware import parts as assembly  # noqa: E402
from spikingtac_hardware.parts import (  # noqa: E402
    Part,
    box,
    common_volume_mm3,
    interferences,
    sensor_parts,
    tool_parts,
)
from spikingtac_hardware.write import write_design  # noqa: E402


@cache
def sensor(name: str) -> tuple[Part, ...]:
    return sensor_parts(Layout(load_design(name)))


@pytest.fixture(scope="module")
def parts() -> dict[str, Part]:
    return {part.name: part for part in (*sensor(DEFAULT), *tool_parts(Layout(load_design())))}


@pytest.mark.parametrize("name", names())
def test_parts_fit_together(name: str) -> None:
    layout = Layout(load_design(name))
    assert interferences(sensor(name)) == {}
    sizes = [part.solid.bounding_box() for part in sensor(name)]
    width, depth = layout.outer.size_mm
    assert max(size.size.X for size in sizes) <= width + 1e-6
    assert max(size.size.Y for size in sizes) <= depth + 1e-6
    assert (min(size.min.Z for size in sizes), max(size.max.Z for size in sizes)) == pytest.approx(
        (0.0, layout.design.housing.height_mm), abs=1e-6
    )


def test_every_screw_meets_its_holes(parts: dict[str, Part]) -> None:
    layout = Layout(load_design())
    for place in layout.screw_places_mm:
        axis = box((1.2, 1.2), place, -1.0, layout.plate_top_mm + 3.4)
        for name in ("base", "shading-plate", "shell"):
            assert common_volume_mm3(parts[name].solid, axis) == 0.0, name


def test_the_mould_gives_the_gel_its_thickness(parts: dict[str, Part]) -> None:
    design = load_design()
    tray, lid = parts["mould-tray"].solid, parts["mould-lid"].solid
    top = design.mould.floor_mm + 2.0 + 2.5 + 0.5
    turned = cad.Pos(0, 0, top + design.mould.lid_mm) * cad.Rot(180, 0, 0) * lid
    # Mirrored about x, the lid's dowel holes lie at the other corners: turn it by a quarter.
    closed = cad.Pos(0, 0, 0) * cad.Rot(0, 0, 90) * turned
    assert common_volume_mm3(tray, closed) == pytest.approx(0.0, abs=1e-6)
    lowest = closed.bounding_box().min.Z
    assert lowest - design.mould.floor_mm - design.window.thickness_mm == pytest.approx(2.5)


@pytest.mark.slow
def test_all_files_are_written_and_can_be_read(tmp_path: Path, verbs: Verbs) -> None:
    folder = tmp_path / "sensor"
    figures = verbs.told("design", "-o", folder)["figures"]
    written = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert len(written) == figures["files"]
    assert {
        "step/sensor.step", "stl/shell.stl", "cut/stencil.dxf", "cut/stencil.svg",
        "cut/window.dxf", "drawings/base.pdf", "drawings/base.svg", "exploded.png", "section.pdf",
        "bill-of-materials.csv", "build-guide.md", "design.toml", "figures.json",
    } <= written  # fmt: skip
    assert 5 < figures["mass_g"] < 15
    assert figures["cost_usd"] < 150
    for path in sorted((folder / "stl").iterdir()):
        mesh = checker.load_mesh(path)
        assert mesh.is_watertight, path.name
        assert mesh.is_winding_consistent, path.name
        step = cad.import_step(folder / "step" / f"{path.stem}.step")
        assert mesh.volume == pytest.approx(step.volume, rel=5e-3), path.name
    assert load_design(folder / "design.toml") == load_design()
    circles = (folder / "cut" / "stencil.svg").read_text().count("<circle")
    assert circles == 64
    verbs.said("design", "-o", folder, code=2)


def test_a_design_whose_parts_overlap_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def slipped(layout: Layout) -> tuple[Part, ...]:
        kept = [part for part in sensor(DEFAULT) if part.name in ("lens", "shading-plate")]
        aside = [cad.Pos(float(part.name == "lens"), 0, 0) * part.solid for part in kept]
        return tuple(replace(part, solid=one) for part, one in zip(kept, aside, strict=True))

    monkeypatch.setattr(assembly, "sensor_parts", slipped)
    with pytest.raises(ConfigError, match="lens and shading-plate overlap by"):
        write_design(load_design(), tmp_path / "sensor")
    assert list(tmp_path.iterdir()) == []
