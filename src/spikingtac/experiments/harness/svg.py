"""Figures of reports as SVG text."""

from __future__ import annotations

import io
from typing import Any

SALT = "spikingtac"
"""Makes the ids in the SVG the same in every run."""


def svg_text(figure: Any) -> str:
    """Return a figure as SVG, the same text each time, and close it."""
    from matplotlib import pyplot, rc_context

    out = io.StringIO()
    with rc_context({"svg.hashsalt": SALT, "svg.fonttype": "none"}):
        figure.savefig(out, format="svg", metadata={"Date": None})
    pyplot.close(figure)
    return out.getvalue()
