"""Printed parts: housing, fasteners, process, mould and holders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from spikingtac_hardware.parameters.valid import require_positive

OutlineKind = Literal["rectangle", "round"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Housing:
    """Base, shading plate and shell.

    Attributes:
        outline: ``rectangle``, or ``round``; then both numbers of ``size_mm`` are the diameter.
        size_mm: Outer ``(width, depth)``, mm.
        height_mm: Outer height with the skin, mm.
        corner_radius_mm: Radius of the upright edges of a rectangle, mm.
        wall_mm: Wall of the shell below the window, mm.
        floor_mm: Floor under the camera board's space, mm.
        base_mm: Height of the base, mm.
        plate_mm: Thickness of the shading plate, mm.
        baffle_mm: Height of the rim about the lens above the plate, mm.
        ledge_mm: Width of the ledge under the window, mm.
        ledge_thickness_mm: Its thickness, mm.
        rim_mm: Height of the shell above the window's upper face, mm.
        cable_mm: Width and height of the slot for the cable, mm.
    """

    outline: OutlineKind
    size_mm: tuple[float, float]
    height_mm: float
    corner_radius_mm: float
    wall_mm: float
    floor_mm: float
    base_mm: float
    plate_mm: float
    baffle_mm: float
    ledge_mm: float
    ledge_thickness_mm: float
    rim_mm: float
    cable_mm: tuple[float, float]

    def __post_init__(self) -> None:
        require_positive(self)
        if self.outline == "round" and self.size_mm[0] != self.size_mm[1]:
            raise ValueError(f"size_mm is {list(self.size_mm)}: a round one has one diameter twice")


@dataclass(frozen=True, kw_only=True, slots=True)
class Fasteners:
    """Four screws from below through base and plate, into heat-set inserts of the shell.

    Attributes:
        thread_mm: Nominal diameter, mm.
        head_mm: Diameter and height of the head, mm.
        lengths_mm: Lengths that the standard lists, mm.
        length_mm: Length of the screws, mm.
        holder_length_mm: Length where a holder is screwed on as well, mm.
        clearance_hole_mm: Diameter of the holes for the thread, mm.
        head_clearance_mm: By which the counterbore is wider than the head, mm.
        counterbore_mm: Depth of the counterbore, mm.
        insert_hole_mm: Diameter of the hole for the insert, mm.
        insert_diameter_mm: Diameter of the insert, mm.
        insert_length_mm: Its length, mm.
        insert_wall_mm: Least wall about its hole, mm.
        insert_hole_depth_mm: Depth of that hole, mm.
        inset_mm: Distance of the screws from the outer faces (of a round housing: from its
            circle, on the diagonals), mm.
    """

    thread_mm: float
    head_mm: tuple[float, float]
    lengths_mm: tuple[float, ...]
    length_mm: float
    holder_length_mm: float
    clearance_hole_mm: float
    head_clearance_mm: float
    counterbore_mm: float
    insert_hole_mm: float
    insert_diameter_mm: float
    insert_length_mm: float
    insert_wall_mm: float
    insert_hole_depth_mm: float
    inset_mm: float

    def __post_init__(self) -> None:
        require_positive(self)


@dataclass(frozen=True, kw_only=True, slots=True)
class Printing:
    """The process that makes the printed parts.

    Attributes:
        process: Its name, for the build guide.
        least_wall_mm: Thinnest wall that it makes, mm.
        clearance_mm: Gap between two printed parts that fit into each other, mm on each side.
        density_g_cm3: Density of the material, g/cm³.
        price_usd_cm3: Price of the material, dollars for each cm³.
    """

    process: str
    least_wall_mm: float
    clearance_mm: float
    density_g_cm3: float
    price_usd_cm3: float

    def __post_init__(self) -> None:
        require_positive(self)


@dataclass(frozen=True, kw_only=True, slots=True)
class Materials:
    """Densities and prices that no other table holds.

    Attributes:
        silicone_g_cm3: Density of gel and cover, g/cm³.
        silicone_usd_g: Their price, dollars for each g.
        acrylic_g_cm3: Density of the window, g/cm³.
        acrylic_usd: Price of one window, dollars.
        paint_usd: Price of the discs, dollars.
        screw_usd: Price of one screw, dollars.
        insert_usd: Price of one insert, dollars.
        cable_usd: Price of the cable, dollars.
        reader_usd: Price of the board that reads the sensor, outside of the housing, dollars.
    """

    silicone_g_cm3: float
    silicone_usd_g: float
    acrylic_g_cm3: float
    acrylic_usd: float
    paint_usd: float
    screw_usd: float
    insert_usd: float
    cable_usd: float
    reader_usd: float

    def __post_init__(self) -> None:
        require_positive(self)


@dataclass(frozen=True, kw_only=True, slots=True)
class Mould:
    """Tray and lid in which gel and cover are cast onto the window.

    Attributes:
        wall_mm: Wall of the tray, mm.
        floor_mm: Floor of the tray, mm.
        lid_mm: Thickness of the lid, mm.
        dowel_mm: Diameter of the two dowels that centre the lid, mm.
    """

    wall_mm: float
    floor_mm: float
    lid_mm: float
    dowel_mm: float

    def __post_init__(self) -> None:
        require_positive(self)


@dataclass(frozen=True, kw_only=True, slots=True)
class Holders:
    """What carries the sensor: a plate for a finger of a Robotiq 2F-85, and an ISO 9409 flange.

    Attributes:
        plate_mm: Thickness that the sensor's screws pass, mm.
        flange_mm: Outer diameter of the flange, mm.
        flange_circle_mm: Diameter of the circle of its four holes, mm.
        flange_hole_mm: Diameter of these holes, mm.
        flange_spigot_mm: Diameter of the centring spigot, mm.
        flange_thickness_mm: Thickness of the flange, mm.
        gripper_length_mm: Length of the plate for the gripper, mm.
        gripper_hole_pitch_mm: Distance of its two holes for the finger, mm.
        gripper_hole_mm: Diameter of these holes, mm.
    """

    plate_mm: float
    flange_mm: float
    flange_circle_mm: float
    flange_hole_mm: float
    flange_spigot_mm: float
    flange_thickness_mm: float
    gripper_length_mm: float
    gripper_hole_pitch_mm: float
    gripper_hole_mm: float

    def __post_init__(self) -> None:
        require_positive(self)
