"""Figures of reports as SVG text."""

from __future__ import annotations

import io
from typing import Any

SALT = "spikingtac"
"""Makes the ids in the SVG the same in every run."""


def pyplot() -> Any:
    """Import and return Matplotlib's pyplot, set to draw without a display."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as module

    return module


def svg_text(figure: Any) -> str:
    """Return a figure as SVG, the same text in every run, and close the figure."""
    from matplotlib import rc_context

    out = io.StringIO()
    with rc_context({"svg.hashsalt": SALT, "svg.fonttype": "none"}):
        figure.savefig(out, format="svg", metadata={"Date": None})
    pyplot().close(figure)
    return out.getvalue()
