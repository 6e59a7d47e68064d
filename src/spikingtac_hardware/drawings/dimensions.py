"""Dimension lines after ISO 129: two extension lines, arrows, the figure above its line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TEXT_PT = 7.0
COLOR = "#0b3c6f"
EXTENSION_MM = 0.5
"""By which an extension line passes the dimension line, mm."""


@dataclass(frozen=True, slots=True)
class Dimension:
    """One dimension.

    Attributes:
        start_mm: ``(2,)`` where it begins, in the plane of the drawing, mm.
        end_mm: ``(2,)`` where it ends, mm.
        away_mm: Distance of the line from the start: to the right of an upright one, above a level
            one, mm.
        text: Its figure.
        upright: True for heights.
        narrow_mm: Length below which the figure of an upright one stands beside its line, mm.
    """

    start_mm: tuple[float, float]
    end_mm: tuple[float, float]
    away_mm: float
    text: str
    upright: bool = False
    narrow_mm: float = 2.4


def draw_dimension(axes: Axes, dimension: Dimension) -> None:
    """Draw a dimension."""
    (x0, y0), (x1, y1), away = dimension.start_mm, dimension.end_mm, dimension.away_mm
    beyond = EXTENSION_MM if away > 0 else -EXTENSION_MM
    if dimension.upright:
        at = x0 + away
        lines = ([(x0, at + beyond), (y0, y0)], [(x1, at + beyond), (y1, y1)])
        ends = (at, y0), (at, y1)
        narrow = abs(y1 - y0) < dimension.narrow_mm
        middle = (at + (0.9 if narrow else -0.25), (y0 + y1) / 2)
        turn, side, level = (0, "left", "center") if narrow else (90, "right", "center")
    else:
        at = y0 + away
        lines = ([(x0, x0), (y0, at + beyond)], [(x1, x1), (y1, at + beyond)])
        ends, middle = ((x0, at), (x1, at)), ((x0 + x1) / 2, at + 0.2)
        turn, side, level = 0, "center", "bottom"
    for x, y in lines:
        axes.plot(x, y, color=COLOR, lw=0.35)
    arrow = {"arrowstyle": "<|-|>,head_length=0.25,head_width=0.1", "lw": 0.45, "color": COLOR,
             "shrinkA": 0, "shrinkB": 0}  # fmt: skip
    axes.annotate("", ends[0], ends[1], arrowprops=arrow)
    axes.text(*middle, dimension.text, rotation=turn, ha=side, va=level, fontsize=TEXT_PT,
              color=COLOR)  # fmt: skip
