"""A tracked stretch as an animated GIF, for papers and pages."""

from __future__ import annotations

from pathlib import Path

from spikingtac.viewer.export.animation import draw_stretch
from spikingtac.viewer.session.source import ViewSource

FRAME_MS = 50
"""Twenty frames per second: GIF counts in 10 ms, and browsers slow down what is below 20 ms."""
MOST_COLORS = 32


def export_gif(view: ViewSource, path: str | Path, *, seconds: float | None = None) -> int:
    """Track a view and write what a page would show; return the number of pictures.

    Args:
        view: From :func:`spikingtac.viewer.session.opening.open_view_source`.
        path: File to write.
        seconds: Length of the stretch from its beginning; None is all of it, a minute at most.

    Raises:
        ConfigError: The source does not end and no length was given, or nothing was tracked.
    """
    first, *rest = pictures = draw_stretch(view, FRAME_MS, MOST_COLORS, seconds)
    first.save(path, save_all=True, append_images=rest, duration=FRAME_MS, loop=0, optimize=True)
    return len(pictures)
