"""The signed evidence that an event on a marker's rim gives for a motion of the marker.

A bright disc that moves in direction d brightens the pixels of its leading rim and darkens those of
its trailing rim. An event of polarity p = +-1 at the angle phi of the rim is therefore evidence for
a motion along p (cos phi, sin phi): to first order this vector is the event's contribution to the
log-likelihood ratio of a small motion. Events that do not come from motion (background, leak,
flicker of the light) cancel around the rim.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.contact.motion.scales import Vector

AFFINE_MODES = 6
"""Motions of the whole field that a sensor is tested for: see :func:`affine_field`."""
OFF_RIM = -1


@dataclass(frozen=True, kw_only=True)
class RimConfig:
    """Which pixels count as a marker's rim.

    The first events of a contact come from where the logarithm of the light is steepest: at the rim
    and a little outside it, where the ground is dark.

    Attributes:
        inside_px: How far the rim reaches towards the disc's centre, px.
        outside_px: How far it reaches outwards, px.
    """

    inside_px: float = 2.0
    outside_px: float = 3.0

    def __post_init__(self) -> None:
        if not (self.inside_px >= 0.0 and self.outside_px >= 0.0):
            raise ValueError("inside_px and outside_px must not be negative")


class RimTable(NamedTuple):
    """The rim pixels of one sensor.

    Attributes:
        row: ``int32[height, width]`` row of each pixel in the other columns, or :data:`OFF_RIM`.
        marker: ``int32[n]`` the marker on whose rim a pixel lies.
        modes: ``float32[n, AFFINE_MODES]`` evidence of an ON event of the pixel for each
            motion of the whole field; an OFF event gives the opposite. The first two modes are the
            translations: there the evidence is the rim's outward unit vector, in image axes.
        center_px: ``(m, 2)`` the markers.
    """

    row: NDArray[np.int32]
    marker: NDArray[np.int32]
    modes: NDArray[np.float32]
    center_px: Vector

    def without(self, pixels: NDArray[np.bool_]) -> RimTable:
        """Return a table that ignores the given pixels ``bool[height, width]``."""
        return self._replace(row=np.where(pixels, OFF_RIM, self.row).astype(np.int32))


def rim_table(calibration: Calibration, config: RimConfig) -> RimTable:
    """Return the rim pixels of a sensor's markers; a pixel between two markers is the nearer's."""
    width, height = calibration.size
    nearest = np.full(width * height, np.inf)
    marker = np.full(width * height, OFF_RIM, np.int32)
    normal = np.zeros((width * height, 2))
    grid_y, grid_x = np.mgrid[0:height, 0:width]
    pixels = np.column_stack([grid_x.ravel(), grid_y.ravel()]).astype(np.float64)
    for index, (center, radius) in enumerate(
        zip(calibration.reference_px, calibration.radius_px, strict=True)
    ):
        offset = pixels - center
        distance = np.hypot(offset[:, 0], offset[:, 1])
        depth = distance - radius
        chosen = (depth >= -config.inside_px) & (depth <= config.outside_px) & (distance > 0.0)
        chosen &= np.abs(depth) < nearest
        nearest[chosen] = np.abs(depth[chosen])
        marker[chosen] = index
        normal[chosen] = offset[chosen] / distance[chosen, None]
    on_rim = np.flatnonzero(marker != OFF_RIM)
    row = np.full(width * height, OFF_RIM, np.int32)
    row[on_rim] = np.arange(len(on_rim), dtype=np.int32)
    outward = normal[on_rim] * (-1.0 if calibration.polarity == "dark" else 1.0)
    of_marker = marker[on_rim]
    modes = affine_field(calibration.reference_px)[of_marker]
    along = np.einsum("na,nak->nk", outward, modes).astype(np.float32)
    return RimTable(
        row.reshape(height, width), of_marker, along, np.asarray(calibration.reference_px)
    )


def affine_field(points_px: Vector) -> Vector:
    """Return ``(m, 2, AFFINE_MODES)``: motion of each point in each mode, about the mean point.

    The modes are two translations, rotation, dilation and two shears; those that grow with the
    distance are scaled to a root mean square of 1 over the points. They hold every motion of a
    field that is linear in the position: a rod that shifts and turns between the pads, a pad that
    is pressed evenly.
    """
    points = np.asarray(points_px, np.float64)
    away = points - points.mean(axis=0)
    size = float(np.sqrt((away**2).sum(axis=1).mean())) or 1.0
    x, y = (away / size).T
    one, none = np.ones(len(points)), np.zeros(len(points))
    along_x = np.column_stack([one, none, -y, x, x, y])
    along_y = np.column_stack([none, one, x, y, -y, x])
    return np.stack([along_x, along_y], axis=1)
