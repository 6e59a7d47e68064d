"""All files of a design: solids, meshes, outlines, drawings, pictures, bill, guide, figures."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikingtac.atomic_files import PARTIAL
from spikingtac.errors import ConfigError
from spikingtac.schema import to_mapping, to_toml
from spikingtac_hardware.bill import Item, as_csv, bill_of_materials, totals
from spikingtac_hardware.checks.check import require_sound
from spikingtac_hardware.figures import figures_of
from spikingtac_hardware.guide import build_guide
from spikingtac_hardware.layout import Layout
from spikingtac_hardware.parameters.design import Design

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from spikingtac_hardware.solids.assembly import Part

FIGURES = "figures.json"
"""The file that says that a folder holds a design."""
SIZE_TOLERANCE_MM = 1e-6
ENDINGS = ("pdf", "svg")
"""Kinds of file of a drawing."""

Advance = Callable[[float], None]


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
    from spikingtac_hardware.solids.assembly import sensor_parts, tool_parts

    layout = Layout(design)
    sensor, tools = sensor_parts(layout), tool_parts(layout)
    _require_fit(layout, sensor)
    told(0.1)
    bill = bill_of_materials(design, {part.name: part.solid.volume for part in sensor})
    mass_g, cost_usd = totals(bill)
    figures = {**figures_of(design), "mass_g": mass_g, "cost_usd": cost_usd}
    partial = target.with_name(f".{target.name}{PARTIAL}{os.getpid()}")
    partial.mkdir(parents=True)
    try:
        _write_solids(layout, (*sensor, *tools), partial)
        told(0.4)
        _write_drawings(layout, sensor, tools, partial)
        told(0.95)
        _write_texts(layout, figures, bill, partial)
        checks = [{**asdict(finding), "passed": finding.passed} for finding in findings]
        files = sum(path.is_file() for path in partial.rglob("*")) + 1
        document = {"design": design.about, "figures": {**figures, "files": files}}
        text = json.dumps({**document, "checks": checks}, indent=1, allow_nan=False)
        (partial / FIGURES).write_text(text + "\n", encoding="utf-8")
        _put_in_place(partial, target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return document["figures"]


def _require_fit(layout: Layout, parts: tuple[Part, ...]) -> None:
    """Refuse parts that overlap, or that stand out of the housing."""
    from spikingtac_hardware.solids.assembly import interferences

    for (one, other), volume in interferences(parts).items():
        raise ConfigError(f"{one} and {other} overlap by {volume:.3f} mm3; move one of them")
    limits = (*layout.outer.size_mm, layout.design.housing.height_mm)
    for part in parts:
        box = part.solid.bounding_box()
        for axis, size, limit in zip("xyz", (box.size.X, box.size.Y, box.max.Z), limits,
                                     strict=True):  # fmt: skip
            if size > limit + SIZE_TOLERANCE_MM:
                raise ConfigError(f"{part.name} is {size:.2f} mm along {axis}; allowed {limit:g}")


def _write_solids(layout: Layout, parts: tuple[Part, ...], folder: Path) -> None:
    from spikingtac_hardware.solids.files import write_meshes, write_outlines, write_steps

    for name in ("step", "stl", "cut"):
        (folder / name).mkdir()
    write_steps(parts, folder / "step", "sensor")
    write_meshes(parts, folder / "stl")
    write_outlines(layout, parts, folder / "cut")


def _write_drawings(
    layout: Layout, sensor: tuple[Part, ...], tools: tuple[Part, ...], folder: Path
) -> None:
    from spikingtac_hardware.drawings.exploded import exploded_view
    from spikingtac_hardware.drawings.mesh import mesh_of
    from spikingtac_hardware.drawings.part_dimensions import dimensions_of
    from spikingtac_hardware.drawings.section import section_view
    from spikingtac_hardware.drawings.sheet import TitleBlock, draw_sheet

    meshes = {part.name: mesh_of(part.solid) for part in (*sensor, *tools)}
    inside = {part.name: meshes[part.name] for part in sensor}
    _save(exploded_view(layout, inside), folder / "exploded", (*ENDINGS, "png"))
    _save(section_view(layout, sensor), folder / "section", (*ENDINGS, "png"))
    (folder / "drawings").mkdir()
    least = layout.design.printing.clearance_mm
    for part in (*sensor, *tools):
        if part.made not in ("printed", "tool"):
            continue
        block = TitleBlock(
            part.name,
            layout.design.about,
            f"printed by {layout.design.printing.process}, black",
            f"general tolerance 0.1, gaps between parts {least:g} a side",
        )
        sheet = draw_sheet(part.solid, meshes[part.name], dimensions_of(part.name, layout), block)
        _save(sheet, folder / "drawings" / part.name, ENDINGS)


def _save(figure: Figure, path: Path, endings: tuple[str, ...]) -> None:
    for ending in endings:
        # No time of day in the files, so that equal designs give equal files.
        dates = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(ending, {})
        figure.savefig(path.with_suffix(f".{ending}"), metadata=dates)


def _write_texts(
    layout: Layout, figures: dict[str, Any], bill: tuple[Item, ...], folder: Path
) -> None:
    texts = {
        "bill-of-materials.csv": as_csv(bill),
        "build-guide.md": build_guide(layout, figures, bill),
        "design.toml": to_toml(to_mapping(layout.design)),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8", newline="\n")


def _put_in_place(partial: Path, target: Path) -> None:
    """Move finished files and folders over those of an earlier design; the figures come last."""
    target.mkdir(parents=True, exist_ok=True)
    (target / FIGURES).unlink(missing_ok=True)
    for entry in sorted(partial.iterdir(), key=lambda entry: entry.name == FIGURES):
        place = target / entry.name
        if place.is_dir():
            shutil.rmtree(place)
        os.replace(entry, place)
