"""How much of a pixel the markers cover."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.camera.pixels import EDGE_ENTRIES
from spikingtac.sim.optics.states import MarkerImage

DISC_DTYPE = np.dtype(
    [
        ("x", "f8"),  # centre, px
        ("y", "f8"),
        ("xx", "f8"),  # shape, see MarkerImage: undeformed = (xx dx + xy dy, yx dx + yy dy)
        ("xy", "f8"),
        ("yx", "f8"),
        ("yy", "f8"),
        ("radius", "f8"),  # px, 0 where no marker is
        ("scale", "f8"),  # undeformed px in one px of the sensor
        ("cut_x", "f8"),  # what is left of a broken disc, see MarkerImage.chord
        ("cut_y", "f8"),
        ("cut", "f8"),
    ],
    align=True,
)
"""A marker on the sensor."""


def discs_of(image: MarkerImage) -> NDArray[Any]:
    """Return an image's markers as ``(m,)`` records of :data:`DISC_DTYPE`."""
    discs = np.empty(len(image.center_px), DISC_DTYPE)
    chord = _WHOLE if image.chord is None else np.asarray(image.chord, np.float64)
    center, shape = (np.asarray(a, np.float64) for a in (image.center_px, image.shape))
    disc_kernel(center, shape, np.asarray(image.radius_px, np.float64), chord, discs)
    return discs


_WHOLE = np.empty((0, 3))
"""No chords: all discs are whole."""


@njit(cache=True, nogil=True, error_model="numpy")
def disc_kernel(
    center_px: NDArray[np.float64],
    shape: NDArray[np.float64],
    radius_px: NDArray[np.float64],
    chord: NDArray[np.float64],
    discs: NDArray[Any],
) -> None:
    """Write the records of ``m`` discs; see :class:`MarkerImage`, ``chord`` may be empty."""
    for k in range(len(discs)):
        disc, form = discs[k], shape[k]
        disc["x"], disc["y"] = center_px[k, 0], center_px[k, 1]
        disc["xx"], disc["xy"] = form[0, 0], form[0, 1]
        disc["yx"], disc["yy"] = form[1, 0], form[1, 1]
        disc["radius"] = radius_px[k]
        disc["scale"] = math.sqrt(abs(form[0, 0] * form[1, 1] - form[0, 1] * form[1, 0]))
        disc["cut_x"], disc["cut_y"], disc["cut"] = 0.0, 0.0, np.inf
        if len(chord):
            disc["cut_x"], disc["cut_y"], disc["cut"] = chord[k, 0], chord[k, 1], chord[k, 2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def edge_kernel(chip: Any, inside_px: float) -> float:
    """Return the coverage at a signed distance inside an edge."""
    if inside_px <= -chip["reach_px"]:
        return 0.0
    if inside_px >= chip["reach_px"]:
        return 1.0
    place = (inside_px + chip["reach_px"]) * chip["edge_per_px"]
    low = min(int(place), EDGE_ENTRIES - 2)
    first = float(chip["edge"][low])
    return first + (place - low) * (chip["edge"][low + 1] - first)


@njit(cache=True, nogil=True, error_model="numpy")
def coverage_kernel(disc: Any, chip: Any, x: float, y: float) -> float:
    """Return the share of a pixel that a marker covers, 0 to 1.

    Blur acts on the sensor: the disc's magnification is undone, its ellipticity is second order.
    """
    dx, dy = x - disc["x"], y - disc["y"]
    u = disc["xx"] * dx + disc["xy"] * dy
    v = disc["yx"] * dx + disc["yy"] * dy
    covered = edge_kernel(chip, (disc["radius"] - math.sqrt(u * u + v * v)) / disc["scale"])
    if disc["cut"] < disc["radius"]:
        left = disc["cut"] - disc["cut_x"] * u - disc["cut_y"] * v
        covered *= edge_kernel(chip, left / disc["scale"])
    return covered if disc["radius"] > 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def paint_kernel(
    discs: NDArray[Any], work: NDArray[Any], chip: Any, coverage: NDArray[np.float32]
) -> None:
    """Write the coverage of every pixel, ``(height, width)``.

    Args:
        discs: ``(m,)`` markers.
        work: ``(m,)`` their boxes, see :data:`~spikingtac.sim.camera.sweep_plan.WORK_DTYPE`.
        chip: Record with the edge profile.
        coverage: Overwritten.
    """
    coverage[:, :] = 0.0
    height, width = coverage.shape
    for k in range(discs.shape[0]):
        disc, box = discs[k], work[k]
        for y in range(max(box["y_first"], 0), min(box["y_last"], height - 1) + 1):
            for x in range(max(box["x_first"], 0), min(box["x_last"], width - 1) + 1):
                covered = coverage_kernel(disc, chip, float(x), float(y))
                coverage[y, x] = max(coverage[y, x], covered)
