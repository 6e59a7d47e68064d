"""The section: the axis with its rays on the left, a row of screws on the right."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from spikingtac_hardware.drawings.dimensions import Dimension, draw_dimension
from spikingtac_hardware.drawings.look import LOOKS, look_label
from spikingtac_hardware.layout import Layout
from spikingtac_hardware.optics import Imaging
from spikingtac_hardware.solids.assembly import Part
from spikingtac_hardware.solids.cut import CutFace, cut_faces

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HATCHED = {"base": "////", "shell": "\\\\\\\\", "shading-plate": "xxxx"}
"""Printed parts -> hatch, as in drawings of machines."""
RAY_COLOR, LED_COLOR, LINE_COLOR = "#d55e00", "#e69f00", "#22272b"
ROOM_MM = 11.5
"""Room beside the parts for names and dimensions, mm."""
WIDTH_IN = 10.5
ASIDE_MM = 1e-3
"""By which a cut stays off a plane of symmetry, where faces may lie, mm."""
LED_INSIDE_MM = 0.2
"""Depth inside of the LEDs at which they are cut, mm."""
DISC_SHARE = 0.67
"""Share of a disc's radius by which the cut passes its middle, towards the axis."""
NOTE_PT = 7.5
LAYERS = (
    "connector", "camera-board", "event-sensor", "lens-holder", "lens", "led-board", "leds",
    "window", "gel", "discs", "cover", "base", "shading-plate", "shell", "inserts", "screws",
)  # fmt: skip
"""Parts in the order in which they are painted."""


def section_view(layout: Layout, parts: Sequence[Part]) -> Figure:
    """Return the section of the assembled sensor as a figure."""
    from matplotlib.figure import Figure

    half = layout.outer.half_mm[0]
    width, height = 2 * (half + ROOM_MM), layout.design.housing.height_mm + 8.0
    size = WIDTH_IN, WIDTH_IN / 2 * height / width
    figure = Figure(figsize=size, dpi=200, facecolor="white", layout="constrained")
    left, right = figure.subplots(1, 2)
    beside = _beside_axis_mm(layout)
    at_axis = {part.name: cut_faces(part.solid, beside + ASIDE_MM) for part in parts}
    at_screws_mm = _through_screws_mm(layout) + ASIDE_MM
    at_screws = {part.name: cut_faces(part.solid, at_screws_mm) for part in parts}
    _paint(left, at_axis)
    _rays(left, layout)
    _names(left, layout, at_axis)
    for dimension in _widths(layout):
        draw_dimension(left, dimension)
    _paint(right, at_screws)
    for dimension in _heights(layout):
        draw_dimension(right, dimension)
    _screw_names(right, layout)
    where = f"{beside:.1f} mm beside the axis" if beside else "through the axis"
    screws = f"{at_screws_mm:.1f} mm beside the axis: screws"
    for axes, title in ((left, where), (right, screws)):
        axes.set_title(title, fontsize=NOTE_PT + 1.5)
        axes.set(xlim=(-half - ROOM_MM, half + ROOM_MM), ylim=(-4.5, height - 4.5), aspect="equal")
        axes.axis("off")
    return figure


def _beside_axis_mm(layout: Layout) -> float:
    """Return the cut next to the axis that passes through a row of discs."""
    skin = layout.design.skin
    odd = skin.grid[0] % 2 == 1
    return 0.0 if odd else skin.pitch_mm / 2 - DISC_SHARE * skin.disc_diameter_mm / 2


def _through_screws_mm(layout: Layout) -> float:
    """Return the cut through two screws, also through LEDs where one cut meets both."""
    light, screw = layout.design.light, layout.screw_places_mm[-1][1]
    leds = light.place_mm + light.led_mm[1] / 2 - LED_INSIDE_MM
    return leds if abs(leds - screw) < layout.design.fasteners.thread_mm / 2 else screw


def _paint(axes: Axes, faces: dict[str, list[CutFace]]) -> None:
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    for name in LAYERS:
        look = LOOKS[name]
        for face in faces.get(name, ()):
            loops = [face.outer_mm, *face.holes_mm]
            path = Path.make_compound_path(*(Path(np.vstack([loop, loop[:1]])) for loop in loops))
            soft = tuple(0.45 + 0.55 * tone for tone in look.color)
            fill = soft if name in HATCHED else look.color
            axes.add_patch(PathPatch(path, fc=fill, ec=LINE_COLOR, lw=0.6,
                                     hatch=HATCHED.get(name)))  # fmt: skip


def _rays(axes: Axes, layout: Layout) -> None:
    """Draw rays from the lens to the edges of the skin and between them."""
    imaging = Imaging(layout)
    edge = layout.window.half_mm[0]
    for reach in np.linspace(-edge, edge, 7):
        tangent = imaging.tangent(np.array([abs(reach)]))
        heights = [layout.window_bottom_mm, layout.window_top_mm, layout.disc_mm]
        at = [float(imaging.radius_mm(tangent, z - layout.window_bottom_mm)[0]) for z in heights]
        x = np.sign(reach) * np.array([0.0, *at])
        outermost = abs(reach) == edge
        axes.plot(x, [layout.pupil_mm, *heights], color=RAY_COLOR, lw=1.0 if outermost else 0.5,
                  alpha=1.0 if outermost else 0.6, zorder=5)  # fmt: skip


def _led_light(axes: Axes, layout: Layout) -> None:
    light, edge = layout.design.light, layout.window.half_mm[0]
    for target in (-0.7, -0.1, 0.5):
        axes.plot([-light.spread_mm, target * edge], [layout.led_top_mm, layout.disc_mm],
                  color=LED_COLOR, lw=0.8, ls=(0, (4, 3)), zorder=4)  # fmt: skip


def _names(axes: Axes, layout: Layout, faces: dict[str, list[CutFace]]) -> None:
    half = layout.outer.half_mm[0]
    middle = layout.window.half_mm[0]
    left = {
        "cover": (-0.9 * middle, layout.design.housing.height_mm - 0.2),
        "gel": (-0.95 * middle, (layout.disc_mm + layout.window_top_mm) / 2),
        "window": (-0.95 * middle, (layout.window_bottom_mm + layout.window_top_mm) / 2),
        "shell": (-half + 0.5, (layout.window_bottom_mm + layout.plate_top_mm) / 2),
        "shading-plate": (-half + 0.5, (layout.base_top_mm + layout.plate_top_mm) / 2),
        "base": (-half + 1.0, layout.base_top_mm / 2),
    }
    place = layout.disc_places_mm[-1][0]
    led = layout.design.light.place_mm
    holder = layout.design.board.holder_mm[0] / 2
    right = {
        "discs": (place, layout.disc_mm + 0.02),
        "lens": (layout.design.lens.barrel_mm / 2 - 0.4, layout.lens_front_mm - 0.4),
        "led-board": (led + 0.8, layout.base_top_mm + 0.3),
        "lens-holder": (holder - 0.4, layout.holder_top_mm - 0.5),
        "event-sensor": (layout.design.sensor.package_mm[0] / 2 - 0.4, layout.board_top_mm + 0.3),
        "camera-board": (layout.design.board.size_mm[0] / 2 - 1.0, layout.board_bottom_mm + 0.4),
    }
    for side, places in ((-1, left), (1, right)):
        shown = {name: at for name, at in places.items() if faces.get(name)}
        heights = np.array([at[1] for at in shown.values()])
        spread = np.linspace(heights.max() + 0.4, max(heights.min() - 1.0, 0.2), len(shown))
        for (name, at), z in zip(shown.items(), spread, strict=True):
            _name(axes, look_label(name, layout.design), at, (side * (half + 2.2), float(z)))


def _screw_names(axes: Axes, layout: Layout) -> None:
    _led_light(axes, layout)
    x, light = layout.screw_places_mm[0][0], layout.design.light
    low = layout.design.fasteners.counterbore_mm
    beside = -layout.outer.half_mm[0] - 2.2
    tip = low + layout.design.fasteners.length_mm
    led = (-light.spread_mm - light.led_mm[0] / 2 + 0.2, layout.led_top_mm - 0.2)
    _name(axes, look_label("leds", layout.design), led, (beside, layout.plate_top_mm - 0.8))
    _name(axes, look_label("inserts", layout.design), (x - 0.95, tip - 1.5), (beside, tip))
    _name(axes, look_label("screws", layout.design), (x, low + 0.5), (beside, low + 1.2))


def _name(axes: Axes, text: str, at: tuple[float, float], beside: tuple[float, float]) -> None:
    axes.annotate(
        text, at, beside, fontsize=NOTE_PT, va="center", color="#1a1a1a",
        ha="left" if beside[0] > 0 else "right", zorder=7,
        arrowprops={"arrowstyle": "-", "lw": 0.5, "color": "#5a6268", "shrinkA": 1, "shrinkB": 0},
    )  # fmt: skip
    axes.plot(*at, ".", color=LINE_COLOR, ms=2.2, zorder=7)


def _heights(layout: Layout) -> list[Dimension]:
    """Return the dimensions of the right half: heights."""
    half = layout.outer.half_mm[0]
    stack = (0.0, layout.base_top_mm, layout.plate_top_mm, layout.window_bottom_mm,
             layout.window_top_mm, layout.disc_mm, layout.design.housing.height_mm)  # fmt: skip
    steps = [
        Dimension((half, low), (half, high), 2.2, f"{high - low:g}", upright=True)
        for low, high in itertools.pairwise(stack)
    ]
    whole = layout.design.housing.height_mm
    return [
        *steps,
        Dimension((half, 0.0), (half, whole), 7.0, f"{whole:g}", upright=True),
    ]


def _widths(layout: Layout) -> list[Dimension]:
    """Return the dimensions of the left half: outer width, and that of the skin."""
    half, wide = layout.outer.half_mm[0], layout.window.half_mm[0]
    whole = layout.design.housing.height_mm
    return [
        Dimension((-half, 0.0), (half, 0.0), -2.0, f"{2 * half:g}"),
        Dimension((-wide, whole), (wide, whole), 1.6, f"{2 * wide:g}"),
    ]
