"""Fraction of each pixel that the markers cover."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.camera.pixel_records import EDGE_ENTRIES
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
        ("chord_x", "f8"),  # what is left of a broken disc, see MarkerImage.chord
        ("chord_y", "f8"),
        ("chord_px", "f8"),
    ],
    align=True,
)
"""One marker on the sensor."""


def discs_of(image: MarkerImage) -> NDArray[Any]:
    """Return the markers of an image as ``(m,)`` records of :data:`DISC_DTYPE`."""
    discs = np.empty(len(image.center_px), DISC_DTYPE)
    chord = _WHOLE if image.chord is None else np.asarray(image.chord, np.float64)
    center, shape = (np.asarray(a, np.float64) for a in (image.center_px, image.shape))
    fill_discs_kernel(center, shape, np.asarray(image.radius_px, np.float64), chord, discs)
    return discs


_WHOLE = np.empty((0, 3))
"""Empty chord array, which means that all discs are whole."""


@njit(cache=True, nogil=True, error_model="numpy")
def fill_discs_kernel(
    center_px: NDArray[np.float64],
    shape: NDArray[np.float64],
    radius_px: NDArray[np.float64],
    chord: NDArray[np.float64],
    discs: NDArray[Any],
) -> None:
    """Write the records of ``m`` discs.

    Args:
        center_px: ``(m, 2)`` centres, px.
        shape: ``(m, 2, 2)`` shapes; see :class:`~spikingtac.sim.optics.states.MarkerImage`.
        radius_px: ``(m,)`` radii, px.
        chord: ``(m, 3)`` chords of broken discs; ``(0, 3)`` if all discs are whole.
        discs: ``(m,)`` records of :data:`DISC_DTYPE`, overwritten.
    """
    for k in range(len(discs)):
        disc, form = discs[k], shape[k]
        disc["x"], disc["y"] = center_px[k, 0], center_px[k, 1]
        disc["xx"], disc["xy"] = form[0, 0], form[0, 1]
        disc["yx"], disc["yy"] = form[1, 0], form[1, 1]
        disc["radius"] = radius_px[k]
        disc["scale"] = math.sqrt(abs(form[0, 0] * form[1, 1] - form[0, 1] * form[1, 0]))
        disc["chord_x"], disc["chord_y"], disc["chord_px"] = 0.0, 0.0, np.inf
        if len(chord):
            disc["chord_x"], disc["chord_y"], disc["chord_px"] = (
                chord[k, 0],
                chord[k, 1],
                chord[k, 2],
            )


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def edge_coverage_kernel(chip: Any, inside_px: float) -> float:
    """Return the coverage (0 to 1) at a signed distance inside an edge, px."""
    if inside_px <= -chip["edge_half_width_px"]:
        return 0.0
    if inside_px >= chip["edge_half_width_px"]:
        return 1.0
    place = (inside_px + chip["edge_half_width_px"]) * chip["edge_per_px"]
    low = min(int(place), EDGE_ENTRIES - 2)
    first = float(chip["edge_coverage"][low])
    return first + (place - low) * (chip["edge_coverage"][low + 1] - first)


@njit(cache=True, nogil=True, error_model="numpy")
def disc_coverage_kernel(disc: Any, chip: Any, x: float, y: float) -> float:
    """Return the fraction of a pixel that a marker covers, 0 to 1.

    The blur acts on the sensor, so the disc's magnification is undone. The effect of its
    ellipticity on the blur is of second order and is neglected.
    """
    dx, dy = x - disc["x"], y - disc["y"]
    u = disc["xx"] * dx + disc["xy"] * dy
    v = disc["yx"] * dx + disc["yy"] * dy
    covered = edge_coverage_kernel(
        chip, (disc["radius"] - math.sqrt(u * u + v * v)) / disc["scale"]
    )
    if disc["chord_px"] < disc["radius"]:
        left = disc["chord_px"] - disc["chord_x"] * u - disc["chord_y"] * v
        covered *= edge_coverage_kernel(chip, left / disc["scale"])
    return covered if disc["radius"] > 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def coverage_image_kernel(
    discs: NDArray[Any], plan: NDArray[Any], chip: Any, coverage: NDArray[np.float32]
) -> None:
    """Write the coverage of every pixel, ``(height, width)``.

    Args:
        discs: ``(m,)`` markers.
        plan: ``(m,)`` bounding boxes, see
            :data:`~spikingtac.sim.camera.sweep_plan.SWEEP_PLAN_DTYPE`.
        chip: Record of :data:`~spikingtac.sim.camera.pixel_records.CHIP_DTYPE`.
        coverage: ``(height, width)`` fractions, overwritten.
    """
    coverage[:, :] = 0.0
    height, width = coverage.shape
    for k in range(discs.shape[0]):
        disc, box = discs[k], plan[k]
        for y in range(max(box["y_first"], 0), min(box["y_last"], height - 1) + 1):
            for x in range(max(box["x_first"], 0), min(box["x_last"], width - 1) + 1):
                covered = disc_coverage_kernel(disc, chip, float(x), float(y))
                coverage[y, x] = max(coverage[y, x], covered)
