"""All files of a design: solids, meshes, outlines, drawings, bill, guide, figures.

Solids and meshes are read again after they are written.
"""

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from spikingtac.atomic_files import whole_folder
from spikingtac.errors import ConfigError, SpikingTacError
from spikingtac_hardware import parts
from spikingtac_hardware.checks import Finding, require_sound
from spikingtac_hardware.design import Design
from spikingtac_hardware.drawings import exploded_view, section_view, sheet
from spikingtac_hardware.figures import as_csv, bill_of_materials, build_guide, figures_of, totals
from spikingtac_hardware.layout import Layout
from spikingtac_hardware.parts import Part, Solid, face, modeller

FIGURES = "figures.json"  # The file that says that a folder holds a design.
FOLDERS = ("step", "stl", "cut", "drawings")
SIZE_TOLERANCE_MM = 1e-6

# Largest distance of an STL's triangles from the surface, mm (an eighth of a layer of powder), and
# largest angle between two of them, rad.
STL_TOLERANCE_MM, STL_TURN_RAD = 0.01, 0.15
STEP_VOLUME = 1e-6  # Largest relative difference of a volume after STEP has been read again.

# Largest relative difference of a mesh's volume: chords of curves cut a little off.
MESH_VOLUME = 5e-3


def write_design(
    design: Design,
    folder: str | Path,
    overwrite: bool = False,
    advance: Callable[[float], None] = lambda done: None,
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
    target = Path(folder)
    if target.is_file():
        raise ConfigError(f"{str(target)!r} is a file; give the name of a folder")
    if (target / FIGURES).is_file() and not overwrite:
        raise ConfigError(
            f"the folder {str(target)!r} holds a design already; "
            "choose another one, or give --overwrite to replace it"
        )
    findings = require_sound(design)
    layout = Layout(design)
    sensor = parts.sensor_parts(layout)
    _require_fit(layout, sensor)
    advance(0.1)
    with whole_folder(target, last=FIGURES) as partial:
        for name in FOLDERS:
            (partial / name).mkdir()
        tools = parts.tool_parts(layout)
        _write_solids(layout, (*sensor, *tools), partial)
        advance(0.4)
        _write_drawings(layout, sensor, tools, partial)
        advance(0.95)
        figures = _write_texts(layout, sensor, findings, partial)
        for name in FOLDERS:  # those of an earlier design
            shutil.rmtree(target / name, ignore_errors=True)
    return figures


def _require_fit(layout: Layout, sensor: Sequence[Part]) -> None:
    """Refuse parts that overlap, or that stand out of the housing."""
    for (one, other), volume in parts.interferences(sensor).items():
        raise ConfigError(f"{one} and {other} overlap by {volume:.3f} mm3; move one of them")
    limits = (*layout.outer.size_mm, layout.design.housing.height_mm)
    for part in sensor:
        box = part.solid.bounding_box()
        sizes = box.size.X, box.size.Y, box.max.Z
        for axis, size, limit in zip("xyz", sizes, limits, strict=True):
            if size > limit + SIZE_TOLERANCE_MM:
                raise ConfigError(f"{part.name} is {size:.2f} mm along {axis}; allowed {limit:g}")


def _write_solids(layout: Layout, every: Sequence[Part], folder: Path) -> None:
    """Write STEP files of all parts and of the sensor, STL of printed ones, outlines of cut ones.

    Raises:
        SpikingTacError: A file that is read again has another volume, or a mesh is not one closed
            body.
    """
    cad = modeller()
    for part in every:
        path = folder / "step" / f"{part.name}.step"
        cad.export_step(_named(part), path)
        _compare(path, cad.import_step(path).volume, part.solid.volume, STEP_VOLUME)
        if part.made in ("printed", "tool"):
            _write_mesh(part, folder / "stl" / f"{part.name}.stl")
    inside = [part for part in every if part.made != "tool"]
    path = folder / "step" / "sensor.step"
    cad.export_step(cad.Compound(label="sensor", children=[_named(part) for part in inside]), path)
    read = sum(solid.volume for solid in cad.import_step(path).solids())
    _compare(path, read, sum(part.solid.volume for part in inside), STEP_VOLUME)
    _write_outlines(layout, {part.name: part.solid for part in every}, folder / "cut")


def _write_mesh(part: Part, path: Path) -> None:
    modeller().export_stl(part.solid, path, STL_TOLERANCE_MM, STL_TURN_RAD)
    mesh = modeller("trimesh").load_mesh(path)
    if not (mesh.is_watertight and mesh.is_winding_consistent and mesh.body_count == 1):
        raise SpikingTacError(f"{path.name} is not one closed body; this design cannot be printed")
    _compare(path, float(mesh.volume), part.solid.volume, MESH_VOLUME)


def _write_outlines(layout: Layout, solids: dict[str, Solid], folder: Path) -> None:
    """Write what is cut: stencil (also as SVG), window, and the outlines of the boards."""
    cad = modeller()
    ring = cad.Circle(layout.design.skin.disc_diameter_mm / 2).edge()
    rings = [cad.Pos(*place, 0) * ring for place in layout.disc_places_mm]
    stencil = {"discs": rings, "skin": list(face(layout.window).edges())}
    drawn = [("stencil.dxf", cad.ExportDXF, stencil), ("stencil.svg", cad.ExportSVG, stencil)]
    for name in ("window", "camera-board", "led-board"):
        lowest = solids[name].faces().sort_by(cad.Axis.Z)[0]
        flat = cad.Pos(0, 0, -lowest.center().Z) * lowest
        drawn.append((f"{name}.dxf", cad.ExportDXF, {"outline": list(flat.edges())}))
    for file, writer, layers in drawn:
        drawing = writer(unit=cad.Unit.MM)
        for name, lines in layers.items():
            drawing.add_layer(name)
            drawing.add_shape(lines, layer=name)
        drawing.write(str(folder / file))


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
    printing, screws = layout.design.printing, layout.design.fasteners
    x, y = layout.screw_places_mm[-1]
    notes = (
        f"printed by {printing.process}, black",
        f"general tolerance 0.1, gaps between parts {printing.clearance_mm:g} a side",
        f"screws {2 * x:.4g} x {2 * y:.4g} apart, holes {screws.clearance_hole_mm:g}, "
        f"for inserts {screws.insert_hole_mm:g} x {screws.insert_hole_depth_mm:g}",
    )
    drawings = {"exploded": exploded_view(sensor), "section": section_view(layout, sensor)}
    for part in (*sensor, *tools):
        if part.made in ("printed", "tool"):
            told = notes[:2] if part.made == "tool" else notes
            drawings[f"drawings/{part.name}"] = sheet(part, layout.design.about, told)
    for name, figure in drawings.items():
        # No time of day in the files, so that equal designs give equal files.
        figure.savefig(folder / f"{name}.pdf", metadata={"CreationDate": None})
        figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
        if "/" not in name:
            figure.savefig(folder / f"{name}.png")


def _write_texts(
    layout: Layout, sensor: Sequence[Part], findings: Sequence[Finding], folder: Path
) -> dict[str, Any]:
    """Write bill, guide, parameters and figures; return the figures."""
    design = layout.design
    bill = bill_of_materials(design, {part.name: part.solid.volume for part in sensor})
    mass_g, cost_usd = totals(bill)
    figures = {**figures_of(design), "mass_g": mass_g, "cost_usd": cost_usd}
    texts = {
        "bill-of-materials.csv": as_csv(bill),
        "build-guide.md": build_guide(layout, figures, bill),
        "design.toml": design.toml(),
    }
    figures["files"] = sum(path.is_file() for path in folder.rglob("*")) + len(texts) + 1
    checks = [{**asdict(finding), "passed": finding.passed} for finding in findings]
    document = {"design": design.about, "figures": figures, "checks": checks}
    texts[FIGURES] = json.dumps(document, indent=1, allow_nan=False) + "\n"
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8", newline="\n")
    return figures
