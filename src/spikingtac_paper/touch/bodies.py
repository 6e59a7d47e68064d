"""Bodies that contacts are drawn with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Body:
    """A body and the ranges of its sizes and depth.

    Attributes:
        name: What it is.
        kind: Name of the indenter.
        sizes_mm: Range of each of its drawn sizes, mm, by the settings that it is given to.
        depth_mm: Range of the depth, mm.
        turned: Whether its heading is drawn, too.
    """

    name: str
    kind: str
    sizes_mm: Mapping[tuple[str, ...], tuple[float, float]]
    depth_mm: tuple[float, float]
    turned: bool = False

    def sizes(self, rng: np.random.Generator) -> dict[str, float]:
        """Return drawn settings of the indenter, mm."""
        settings: dict[str, float] = {}
        for names, span_mm in self.sizes_mm.items():
            settings |= dict.fromkeys(names, float(rng.uniform(*span_mm)))
        return settings


BOTH_RADII = ("radius_x_mm", "radius_y_mm")
"""Settings of a body that is round about its axis."""
ROUND = (
    Body("ball", "ball", {BOTH_RADII: (3.0, 8.0)}, (0.4, 0.9)),
    Body("punch", "punch", {("radius_mm",): (2.0, 4.5)}, (0.2, 0.45)),
    Body("finger", "finger", {BOTH_RADII: (6.0, 8.0)}, (1.2, 2.2)),
)
"""Bodies that are alike from all sides."""
LONG = (
    Body(
        "ellipsoid",
        "ball",
        {
            ("radius_x_mm",): (5.0, 20.0),
            ("radius_y_mm",): (5.0, 20.0),
            ("half_height_mm",): (5.0, 12.0),
        },
        (0.4, 0.8),
        turned=True,
    ),
    Body(
        "rod",
        "probe",
        {("radius_mm",): (2.0, 6.0), ("length_mm",): (2.0, 8.0)},
        (0.3, 0.8),
        turned=True,
    ),
)
"""Bodies that are longer in one direction."""
TAUGHT = (*ROUND, *LONG)
"""Bodies that the slip model is fitted to."""
TESTED = (*ROUND, Body("spoon", "spoon", {}, (0.4, 0.8)))
"""Bodies that it is tested on: the spoon was never seen."""
