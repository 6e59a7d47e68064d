"""The signed evidence that events on the markers' rims give for motions of the whole field.

The signed evidence that an event on a marker's rim gives for a motion of the marker.

A bright disc that moves in direction d brightens the pixels of its leading rim and darkens those of
its trailing rim. An event of polarity p = +-1 at the angle phi of the rim is therefore evidence for
a motion along p (cos phi, sin phi): to first order this vector is the event's contribution to the
log-likelihood ratio of a small motion. Events that do not come from motion (background, leak,
flicker of the light) cancel around the rim.

Sum the evidence of a window's events for each motion of the whole field.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.contact.scales import Vector
from spikingtac.contact.window import Window, packets_of
from spikingtac.errors import ConfigError

# Motions of the whole field that a sensor is tested for: see :func:`affine_field`.
AFFINE_MODES = 6
OFF_RIM = -1


# How far a rim reaches towards the disc's centre and outwards, px. The first events of a contact
# come from where the logarithm of the light is steepest: at the rim and a little outside it.
INSIDE_PX, OUTSIDE_PX = 2.0, 3.0


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


def rim_table(calibration: Calibration) -> RimTable:
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
        chosen = (depth >= -INSIDE_PX) & (depth <= OUTSIDE_PX) & (distance > 0.0)
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


POLARITIES = 2  # OFF and ON evidence are summed apart: the leak of the pixels fires ON only.
SENSOR_VALUES = POLARITIES * AFFINE_MODES


class EvidenceSums:
    """Sums the evidence of each window, and keeps each marker's recent evidence.

    Args:
        tables: The rims of each sensor, in the windows' order.
        memory: How many windows of the markers' own evidence are kept.
    """

    def __init__(self, tables: Sequence[RimTable], memory: int) -> None:
        self.tables = tuple(tables)
        self.length = SENSOR_VALUES * len(self.tables)
        self._memory = memory
        self._evidence = np.zeros((len(self.tables), POLARITIES, AFFINE_MODES))
        self._recent = tuple(
            np.zeros((memory, len(table.center_px), 2), np.float32) for table in self.tables
        )
        self._filled = 0

    def add(self, window: Window) -> NDArray[np.float64]:
        """Return the window's evidence ``(length,)``: by sensor, OFF before ON, by mode.

        The next call overwrites the array.

        Raises:
            ConfigError: The window has another number of sensors than the calibrations, or
                sensors of another size.
        """
        packets = packets_of(window)
        if len(packets) != len(self.tables):
            raise ConfigError(
                f"the windows hold {len(packets)} sensors, the detector was built for "
                f"{len(self.tables)}"
            )
        slot = self._filled % self._memory
        for sensor, (packet, table) in enumerate(zip(packets, self.tables, strict=True)):
            packet.require_map(table.row.shape)
            evidence_kernel(
                packet.x, packet.y, packet.p, table.row, table.marker, table.modes,
                self._evidence[sensor], self._recent[sensor][slot],
            )  # fmt: skip
        self._filled += 1
        return self._evidence.reshape(-1)

    def recent(self, windows: int) -> tuple[NDArray[np.float64], ...]:
        """Return the evidence ``(m, 2)`` of each sensor's markers over the last windows."""
        kept = min(windows, self._filled, self._memory)
        slots = np.arange(self._filled - kept, self._filled) % self._memory
        return tuple(ring[slots].sum(axis=0, dtype=np.float64) for ring in self._recent)

    def reset(self) -> None:
        """Forget the markers' recent evidence."""
        self._filled = 0


@njit(cache=True)
def evidence_kernel(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    row: NDArray[np.int32],
    marker: NDArray[np.int32],
    modes: NDArray[np.float32],
    evidence: NDArray[np.float64],
    by_marker: NDArray[np.float32],
) -> None:
    """Sum a packet's evidence into ``evidence (2, modes)`` by polarity and ``by_marker (m, 2)``.

    The table's columns are separate parameters: a call with a tuple of arrays takes twice as long.
    """
    evidence[:] = 0.0
    by_marker[:] = 0.0
    for event in range(len(x)):
        place = row[y[event], x[event]]
        if place == OFF_RIM:
            continue
        polarity = 1 if p[event] else 0
        sign = 1.0 if p[event] else -1.0
        for mode in range(evidence.shape[1]):
            evidence[polarity, mode] += sign * modes[place, mode]
        of = marker[place]
        by_marker[of, 0] += sign * modes[place, 0]
        by_marker[of, 1] += sign * modes[place, 1]
