"""Files of solids: STEP, STL, and flat outlines as DXF and SVG. What is written is read again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from spikingtac.errors import SpikingTacError
from spikingtac_hardware.layout import Layout
from spikingtac_hardware.solids.assembly import Part
from spikingtac_hardware.solids.cad import Solid, mesh_checker, modeller
from spikingtac_hardware.solids.shapes import face

STL_TOLERANCE_MM = 0.01
"""Largest distance of an STL's triangles from the surface, mm (an eighth of a layer of powder)."""
STL_TURN_RAD = 0.15
STEP_VOLUME = 1e-6
"""Largest relative difference of a volume after STEP has been read again."""
MESH_VOLUME = 5e-3
"""Largest relative difference of a mesh's volume: chords of curves cut a little off."""


def write_steps(parts: Sequence[Part], folder: Path, assembly: str) -> None:
    """Write a STEP file of each part, and one of all parts that ``assembly`` names.

    Args:
        parts: The parts; tools get a file of their own, but are not in the assembly.
        folder: Where the files go; it exists.
        assembly: Name of the file of the assembly, without its ending.

    Raises:
        SpikingTacError: A file that is read again has another volume.
    """
    cad = modeller()
    for part in parts:
        path = folder / f"{part.name}.step"
        cad.export_step(_named(part), path)
        _compare(path, cad.import_step(path).volume, part.solid.volume, STEP_VOLUME)
    inside = [part for part in parts if part.made != "tool"]
    whole = cad.Compound(label=assembly, children=[_named(part) for part in inside])
    path = folder / f"{assembly}.step"
    cad.export_step(whole, path)
    read = sum(solid.volume for solid in cad.import_step(path).solids())
    _compare(path, read, sum(part.solid.volume for part in inside), STEP_VOLUME)


def write_meshes(parts: Sequence[Part], folder: Path) -> None:
    """Write an STL file of each part that is printed, and check it with trimesh.

    Raises:
        SpikingTacError: A mesh is not closed, is turned inside out, or has another volume.
    """
    cad, checker = modeller(), mesh_checker()
    for part in parts:
        if part.made not in ("printed", "tool"):
            continue
        path = folder / f"{part.name}.stl"
        cad.export_stl(part.solid, path, STL_TOLERANCE_MM, STL_TURN_RAD)
        mesh = checker.load_mesh(path)
        if not (mesh.is_watertight and mesh.is_winding_consistent and mesh.body_count == 1):
            raise SpikingTacError(
                f"{path.name} is not one closed body; this design cannot be printed"
            )
        _compare(path, float(mesh.volume), part.solid.volume, MESH_VOLUME)


def write_outlines(layout: Layout, parts: Sequence[Part], folder: Path) -> None:
    """Write what is cut: stencil (also as SVG), window, and the outlines of the boards."""
    cad = modeller()
    by_name = {part.name: part.solid for part in parts}
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
