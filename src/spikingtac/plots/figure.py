"""What all figures share: colours, fonts and widths for paper and for screens, and their files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from spikingtac.atomic_files import replacing, require_free
from spikingtac.errors import named

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure
    from PIL.Image import Image

ThemeName = Literal["light", "dark"]
WidthName = Literal["single", "double"]
EventKind = Literal["overview", "moment", "rate", "surface", "hot"]

# Widths of one and of two columns of an IEEE paper, inches (IEEE author centre).
WIDTHS_IN = {"single": 3.5, "double": 7.16}
DPI = 300  # Dots per inch of bitmaps: what publishers ask for.
PAD_IN = 0.03  # Free space around a figure, inches: Matplotlib's own of its layout, about.
COLORS = 256  # Steps of a colour map: those of a picture of 8 bits.
FONT_PT = 8.0  # Size of text in a figure of one column, points.
PICTURE_ENDINGS = (".png", ".svg", ".pdf")


@dataclass(frozen=True, kw_only=True)
class Theme:
    """Colours of a figure.

    Attributes:
        ground: Behind everything.
        text: Text, axes and ticks.
        soft: What is in the background: grids, resting markers, single markers' lines.
        strong: What the figure is about.
        second: What it is compared with.
        on: ON events, as on the page of ``view``.
        off: OFF events.
        sequential: Part of viridis, a perceptually uniform map, for magnitudes: where it begins and
            ends, 0 to 1. What is small is near to the ground, what is large stands out from it.
    """

    ground: str
    text: str
    soft: str
    strong: str
    second: str
    on: str
    off: str
    sequential: tuple[float, float]

    def magnitudes(self) -> Colormap:
        """Return the colour map of magnitudes."""
        import matplotlib as mpl
        from matplotlib.colors import ListedColormap

        return ListedColormap(mpl.colormaps["viridis"](np.linspace(*self.sequential, COLORS)))


# Name -> colours. The two hues are told apart by deuteranopes too (Okabe and Ito, 2008: blue and
# orange).
THEMES = {
    "light": Theme(
        ground="white", text="#1a1a1a", soft="#9aa3aa", strong="#0072b2", second="#d55e00",
        on="#1436b0", off="#e33be3", sequential=(0.85, 0.0),
    ),
    "dark": Theme(
        ground="#0b0d0e", text="#dbe0e3", soft="#6d777e", strong="#56b4e9", second="#e69f00",
        on="#2aa5ff", off="#7a5cff", sequential=(0.25, 1.0),
    ),
}  # fmt: skip


def new_figure(theme: str, width: str, height_share: float) -> tuple[Figure, Theme]:
    """Return an empty figure and its theme.

    Args:
        theme: A name in :data:`THEMES`.
        width: A name in :data:`WIDTHS_IN`.
        height_share: Height over width.

    Raises:
        ConfigError: A name is unknown.
    """
    from matplotlib.figure import Figure

    colors, wide = named(THEMES, theme, "theme"), named(WIDTHS_IN, width, "width")
    size = wide, wide * height_share
    return Figure(figsize=size, dpi=DPI, facecolor=colors.ground, layout="constrained"), colors


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, SVG or PDF; it appears whole or not at all.

    Raises:
        ConfigError: The ending is none of these, or the folder does not exist.
    """
    require_free(path, True, PICTURE_ENDINGS)
    with replacing(path) as partial:
        figure.savefig(partial, facecolor=figure.get_facecolor(), dpi=DPI)


def drawn(canvas: FigureCanvasAgg, most_colors: int) -> Image:
    """Draw a figure as it stands, with a palette of its own, for an animation."""
    from PIL.Image import Dither, fromarray

    canvas.draw()
    picture = fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
    return picture.quantize(most_colors, dither=Dither.NONE)


def save_gif(pictures: Sequence[Image], frame_ms: int, path: Path) -> None:
    """Write pictures as an animation that is played again and again."""
    first, *rest = pictures
    look: dict[str, Any] = {"save_all": True, "append_images": rest, "loop": 0, "optimize": True}
    first.save(path, "GIF", duration=frame_ms, **look)


def legend_above(axes: Axes, theme: Theme) -> None:
    """Name the curves above the axes, where none of them runs."""
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=len(axes.get_legend_handles_labels()[1]),
        borderpad=0.0,
        fontsize=FONT_PT - 1,
        frameon=False,
        labelcolor=theme.text,
    )


def style_axes(axes: Axes, theme: Theme) -> None:
    """Give axes the theme's colours and the figure's size of text."""
    axes.set_facecolor(theme.ground)
    axes.tick_params(colors=theme.text, labelsize=FONT_PT - 1)
    for side, spine in axes.spines.items():
        spine.set_color(theme.text)
        spine.set_visible(side in ("left", "bottom"))
    for label in (axes.xaxis.label, axes.yaxis.label, axes.title):
        label.set_color(theme.text)
        label.set_fontsize(FONT_PT)
