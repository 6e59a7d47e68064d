"""A displacement field in a few numbers around the contact: shift, growth and turn at four widths.

Where a contact sticks, the skin under it moves as one piece; where its rim slips, only the middle
does. So the share that sticks shows in how the shift of the skin falls off with the distance from
the contact's centre (C. Cattaneo 1938; R. D. Mindlin, "Compliance of elastic bodies in contact",
J. Appl. Mech. 16, 1949).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.pitch import marker_pitch_px

Field = NDArray[np.float64]

WIDTHS = (0.6, 1.0, 1.6, 2.6)
"""Widths of the Gaussian windows, pitches of the markers (ours: from one marker to the patch)."""
MIDDLE = 1
"""Index of the width by which strength and direction are told."""
LEAST_ARM = 0.05
"""Square of the arm, pitches squared, below which growth and turn are damped (ours)."""
LEAST_SQUARE = 1e-12
"""Weight of a marker that stands still, pitches squared, so that a field at rest has a centre."""
SIZE = 4 * len(WIDTHS) + 2
"""Numbers of a summary: shifts (4, 2), growths (4,), turns (4,), centre (2,)."""


class FieldSummary:
    """Summarises the displacement fields of one sensor, in pitches of its markers.

    Attributes:
        pitch: Distance between neighbours, in the unit of the markers.
        places: ``(m, 2)`` the markers at rest, pitches.
        decay: ``(k,)`` halves of the inverse squared widths of the windows.
    """

    def __init__(self, reference: Field) -> None:
        """Prepare for markers ``(m, 2)`` at rest, px or mm.

        Raises:
            ConfigError: Fewer than two markers.
        """
        self.pitch = marker_pitch_px(reference)
        self.places = np.ascontiguousarray(reference / self.pitch)
        self.decay = np.array([0.5 / width**2 for width in WIDTHS])

    def of(self, displacement: Field) -> Field:
        """Return the summary ``(SIZE,)`` of displacements ``(m, 2)`` in the unit of the markers.

        Shifts, growths and turns are in pitches (growth and turn: of a place one pitch from the
        centre); the centre is in pitches from the image's origin.
        """
        out = np.empty(SIZE)
        field_summary_kernel(self.places, displacement / self.pitch, self.decay, out)
        return out


@njit(cache=True, nogil=True)
def field_summary_kernel(places: Field, moved: Field, decay: Field, out: Field) -> None:
    """Summarise one field.

    Args:
        places: ``(m, 2)`` markers at rest, pitches.
        moved: ``(m, 2)`` their displacements, pitches.
        decay: ``(k,)`` halves of the inverse squared widths.
        out: ``(4 k + 2,)`` overwritten.
    """
    widths, total, x0, y0 = len(decay), 0.0, 0.0, 0.0
    for marker in range(len(places)):
        square = moved[marker, 0] ** 2 + moved[marker, 1] ** 2 + LEAST_SQUARE
        total += square
        x0 += square * places[marker, 0]
        y0 += square * places[marker, 1]
    x0 /= total
    y0 /= total
    for k in range(widths):
        weight, x, y, arm, out_of, turn = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for marker in range(len(places)):
            away_x, away_y = places[marker, 0] - x0, places[marker, 1] - y0
            far = away_x**2 + away_y**2
            share = np.exp(-decay[k] * far)
            u, v = moved[marker, 0], moved[marker, 1]
            weight += share
            x += share * u
            y += share * v
            arm += share * far
            out_of += share * (u * away_x + v * away_y)
            turn += share * (away_x * v - away_y * u)
        arm = arm / weight + LEAST_ARM
        out[2 * k], out[2 * k + 1] = x / weight, y / weight
        out[2 * widths + k] = out_of / weight / arm
        out[3 * widths + k] = turn / weight / arm
    out[4 * widths], out[4 * widths + 1] = x0, y0
