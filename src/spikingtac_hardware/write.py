"""All files of a design: solids, meshes, outlines, drawings, bill, guide, figures.

Solids and meshes are read again after they are written.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikingtac.atomic_files import PARTIAL
from spikingtac.errors import ConfigError, SpikingTacError
from spikingtac_hardware import parts
from spikingtac_hardware.checks import require_sound
from spikingtac_hardware.design import Design
from spikingtac_hardware.figures import (
    as_csv,
    bill_of_materials,
    build_guide,
    figures_of,
    totals,
)
from spikingtac_hardware.layout import Layout
from spikingtac_hardware.parts import Part
from spikingtac_hardware.solids import Solid, face, mesh_checker, modeller

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES = "figures.json"  # The file that says that a folder holds a design.
SIZE_TOLERANCE_MM = 1e-6
ENDINGS = ("pdf", "svg")  # Kinds of file of a drawing.

Advance = Callable[[float], None]

# Largest distance of an STL's triangles from the surface, mm (an eighth of a layer of powder).
STL_TOLERANCE_MM = 0.01
STL_TURN_RAD = 0.15
STEP_VOLUME = 1e-6  # Largest relative difference of a volume after STEP has been read again.

# Largest relative difference of a mesh's volume: chords of curves cut a little off.
MESH_VOLUME = 5e-3


def require_free_folder(folder: Path, overwrite: bool) -> None:
    """Refuse to replace an existing design without permission.

    Raises:
        ConfigError: The folder holds a design, or the path is a file.
    """
    if folder.is_file():
        raise ConfigError(f"{str(folder)!r} is a file; give the name of a folder")
    if (folder / FIGURES).is_file() and not overwrite:
        raise ConfigError(
            f"the folder {str(folder)!r} holds a design already; "
            "choose another one, or give --overwrite to replace it"
        )


def write_design(
    design: Design, folder: str | Path, overwrite: bool = False, advance: Advance | None = None
) -> dict[str, Any]:
    """Write all files of a design, whole or not at all.

    Args:
        design: The design; it must pass every check.
        folder: Where the files go; other files there stay.
        overwrite: Replace a design that is there.
        advance: Told the fraction that is done.

    Returns:
        The figures, with mass, cost and the number of files.

    Raises:
        ConfigError: A check fails, two parts overlap, or the folder holds a design.
        MissingExtraError: The extra ``[design]`` is not installed.
    """
    target, told = Path(folder), advance or (lambda done: None)
    require_free_folder(target, overwrite)
    findings = require_sound(design)
    layout = Layout(design)
    sensor, tools = parts.sensor_parts(layout), parts.tool_parts(layout)
    _require_fit(layout, sensor)
    told(0.1)
    bill = bill_of_materials(design, {part.name: part.solid.volume for part in sensor})
    mass_g, cost_usd = totals(bill)
    figures = {**figures_of(design), "mass_g": mass_g, "cost_usd": cost_usd}
    partial = target.with_name(f".{target.name}{PARTIAL}{os.getpid()}")
    partial.mkdir(parents=True)
    try:
        for name in ("step", "stl", "cut", "drawings"):
            (partial / name).mkdir()
        _write_steps((*sensor, *tools), partial / "step")
        _write_meshes((*sensor, *tools), partial / "stl")
        _write_outlines(layout, (*sensor, *tools), partial / "cut")
        told(0.4)
        _write_drawings(layout, sensor, tools, partial)
        told(0.95)
        texts = {
            "bill-of-materials.csv": as_csv(bill),
            "build-guide.md": build_guide(layout, figures, bill),
            "design.toml": design.toml(),
        }
        for name, text in texts.items():
            (partial / name).write_text(text, encoding="utf-8", newline="\n")
        checks = [{**asdict(finding), "passed": finding.passed} for finding in findings]
        files = sum(path.is_file() for path in partial.rglob("*")) + 1
        document = {"design": design.about, "figures": {**figures, "files": files}}
        text = json.dumps({**document, "checks": checks}, indent=1, allow_nan=False)
        (partial / FIGURES).write_text(text + "\n", encoding="utf-8")
        _put_in_place(partial, target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return document["figures"]


def _require_fit(layout: Layout, sensor: Sequence[Part]) -> None:
    """Refuse parts that overlap, or that stand out of the housing."""
    for (one, other), volume in parts.interferences(sensor).items():
        raise ConfigError(f"{one} and {other} overlap by {volume:.3f} mm3; move one of them")
    limits = (*layout.outer.size_mm, layout.design.housing.height_mm)
    for part in sensor:
        box = part.solid.bounding_box()
        for axis, size, limit in zip("xyz", (box.size.X, box.size.Y, box.max.Z), limits,
                                     strict=True):  # fmt: skip
            if size > limit + SIZE_TOLERANCE_MM:
                raise ConfigError(f"{part.name} is {size:.2f} mm along {axis}; allowed {limit:g}")


def _write_steps(every: Sequence[Part], folder: Path) -> None:
    """Write a STEP file of each part, and one of the sensor.

    Raises:
        SpikingTacError: A file that is read again has another volume.
    """
    cad = modeller()
    for part in every:
        path = folder / f"{part.name}.step"
        cad.export_step(_named(part), path)
        _compare(path, cad.import_step(path).volume, part.solid.volume, STEP_VOLUME)
    inside = [part for part in every if part.made != "tool"]
    whole = cad.Compound(label="sensor", children=[_named(part) for part in inside])
    path = folder / "sensor.step"
    cad.export_step(whole, path)
    read = sum(solid.volume for solid in cad.import_step(path).solids())
    _compare(path, read, sum(part.solid.volume for part in inside), STEP_VOLUME)


def _write_meshes(every: Sequence[Part], folder: Path) -> None:
    """Write an STL file of each part that is printed, and check it with trimesh.

    Raises:
        SpikingTacError: A mesh is not closed, is turned inside out, or has another volume.
    """
    cad, checker = modeller(), mesh_checker()
    for part in _printed(every):
        path = folder / f"{part.name}.stl"
        cad.export_stl(part.solid, path, STL_TOLERANCE_MM, STL_TURN_RAD)
        mesh = checker.load_mesh(path)
        if not (mesh.is_watertight and mesh.is_winding_consistent and mesh.body_count == 1):
            raise SpikingTacError(
                f"{path.name} is not one closed body; this design cannot be printed"
            )
        _compare(path, float(mesh.volume), part.solid.volume, MESH_VOLUME)


def _write_outlines(layout: Layout, every: Sequence[Part], folder: Path) -> None:
    """Write what is cut: stencil (also as SVG), window, and the outlines of the boards."""
    cad = modeller()
    by_name = {part.name: part.solid for part in every}
    radius = layout.design.skin.disc_diameter_mm / 2
    rings = [cad.Pos(*place, 0) * cad.Circle(radius).edge() for place in layout.disc_places_mm]
    frame = list(face(layout.window).edges())
    for writer, ending in ((cad.ExportDXF, "dxf"), (cad.ExportSVG, "svg")):
        stencil = writer(unit=cad.Unit.MM)
        for name, lines in (("discs", rings), ("skin", frame)):
            stencil.add_layer(name)
            stencil.add_shape(lines, layer=name)
        stencil.write(str(folder / f"stencil.{ending}"))
    for name in ("window", "camera-board", "led-board"):
        outline = cad.ExportDXF(unit=cad.Unit.MM)
        outline.add_layer("outline")
        lowest = by_name[name].faces().sort_by(cad.Axis.Z)[0]
        height = lowest.center().Z
        outline.add_shape(list((cad.Pos(0, 0, -height) * lowest).edges()), layer="outline")
        outline.write(str(folder / f"{name}.dxf"))


def _named(part: Part) -> Solid:
    solid = modeller().Compound(list(part.solid.solids()))
    solid.label = part.name
    return solid


def _compare(path: Path, found: float, wanted: float, allowed: float) -> None:
    if abs(found - wanted) > allowed * wanted:
        raise SpikingTacError(
            f"{path.name} has {found:.3f} mm3 when it is read again, the solid has {wanted:.3f}; "
            "please report it with the design's TOML file"
        )


def _write_drawings(
    layout: Layout, sensor: Sequence[Part], tools: Sequence[Part], folder: Path
) -> None:
    from spikingtac_hardware.drawings import exploded_view, section_view, sheet

    printing, screws = layout.design.printing, layout.design.fasteners
    _save(exploded_view(sensor), folder / "exploded", (*ENDINGS, "png"))
    _save(section_view(layout, sensor), folder / "section", (*ENDINGS, "png"))
    x, y = layout.screw_places_mm[-1]
    notes = (
        f"printed by {printing.process}, black",
        f"general tolerance 0.1, gaps between parts {printing.clearance_mm:g} a side",
        f"screws {2 * x:.4g} x {2 * y:.4g} apart, holes {screws.clearance_hole_mm:g}, "
        f"for inserts {screws.insert_hole_mm:g} x {screws.insert_hole_depth_mm:g}",
    )
    for part in _printed((*sensor, *tools)):
        drawing = sheet(part, layout.design.about, notes[:2] if part.made == "tool" else notes)
        _save(drawing, folder / "drawings" / part.name, ENDINGS)


def _printed(every: Sequence[Part]) -> list[Part]:
    return [part for part in every if part.made in ("printed", "tool")]


def _save(figure: Figure, path: Path, endings: tuple[str, ...]) -> None:
    for ending in endings:
        # No time of day in the files, so that equal designs give equal files.
        dates = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(ending, {})
        figure.savefig(path.with_suffix(f".{ending}"), metadata=dates)


def _put_in_place(partial: Path, target: Path) -> None:
    """Move finished files and folders over those of an earlier design; the figures come last."""
    target.mkdir(parents=True, exist_ok=True)
    (target / FIGURES).unlink(missing_ok=True)
    for entry in sorted(partial.iterdir(), key=lambda entry: entry.name == FIGURES):
        place = target / entry.name
        if place.is_dir():
            shutil.rmtree(place)
        os.replace(entry, place)
