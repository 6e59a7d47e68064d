"""A shaded picture of parts: parallel projection, depth buffer, lines at the creases."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.arrays import FloatArray
from spikingtac_hardware.drawings.mesh import Mesh

AMBIENT = 0.45
"""Brightness of a face in the shade."""
LINE = np.array([0.10, 0.12, 0.14])
"""Colour of a line."""
LINE_LIFT_MM = 0.06
"""By which a line stands over its faces, so that they do not hide it, mm."""
LAMP = np.array([-0.35, 0.55, 0.76])
"""Where the light comes from, as seen: left, above, in front."""
OVERSAMPLING = 2
"""Samples in a pixel, along x and along y."""


@dataclass(frozen=True, slots=True)
class Shown:
    """A part in a picture.

    Attributes:
        mesh: Its triangles.
        color: Red, green, blue, 0 to 1.
        lift_mm: By which it is shown above its place, mm.
        opacity: 1 hides what is behind; less lets it through.
    """

    mesh: Mesh
    color: tuple[float, float, float]
    lift_mm: float = 0.0
    opacity: float = 1.0


class View:
    """A direction from which parts are seen, in parallel projection.

    Args:
        azimuth_deg: Turn about the upright axis, degrees.
        elevation_deg: Height above the horizon, degrees.
    """

    def __init__(self, azimuth_deg: float, elevation_deg: float) -> None:
        turn, rise = math.radians(azimuth_deg), math.radians(elevation_deg)
        toward = np.array([math.cos(rise) * math.cos(turn), math.cos(rise) * math.sin(turn),
                           math.sin(rise)])  # fmt: skip
        right = np.array([-math.sin(turn), math.cos(turn), 0.0])
        self._axes = np.stack([right, np.cross(toward, right), toward])

    def seen(self, points_mm: FloatArray) -> FloatArray:
        """Return points ``(n, 3)`` as right, up and towards the eye, mm."""
        return points_mm @ self._axes.T


def _points(part: Shown, view: View) -> FloatArray:
    return view.seen(part.mesh.corner_mm + np.array([0.0, 0.0, part.lift_mm]))


class Canvas:
    """A picture under way.

    Args:
        low_mm: ``(2,)`` right and up of the lower left corner, mm.
        high_mm: ``(2,)`` of the upper right corner, mm.
        px_per_mm: Scale.
    """

    def __init__(self, low_mm: FloatArray, high_mm: FloatArray, px_per_mm: float) -> None:
        self._low, self._scale = low_mm, px_per_mm * OVERSAMPLING
        width, height = (np.ceil((high_mm - low_mm) * px_per_mm) * OVERSAMPLING).astype(int)
        self._color = np.ones((height, width, 3))
        self._depth = np.full((height, width), -np.inf)

    def image(self) -> NDArray[np.uint8]:
        """Return the picture ``(height, width, 3)``, its first row uppermost."""
        height, width, _ = self._color.shape
        n = OVERSAMPLING
        mean = self._color.reshape(height // n, n, width // n, n, 3).mean(axis=(1, 3))
        return np.round(255 * mean[::-1].clip(0, 1)).astype(np.uint8)

    def draw(self, parts: Sequence[Shown], view: View) -> None:
        """Draw parts: what is opaque, its creases, then what lets light through, from the back."""
        opaque = [part for part in parts if part.opacity == 1]
        clear = [part for part in parts if part.opacity < 1]
        for part in opaque:
            self._faces(part, view, self._depth, self._color)
        for part in opaque:
            self._creases(part, view, self._depth)
        for part in sorted(clear, key=lambda part: float(_points(part, view)[:, 2].mean())):
            # It hides its own back, but not what was drawn before.
            depth, fresh = self._depth.copy(), self._color.copy()
            self._faces(part, view, depth, fresh)
            self._color += part.opacity * (fresh - self._color)
            self._creases(part, view, depth)

    def _faces(self, part: Shown, view: View, depth: FloatArray, target: FloatArray) -> None:
        triangles = _points(part, view)[part.mesh.triangle]
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        length = np.linalg.norm(normal, axis=1)
        front = (normal[:, 2] > 0) & (length > 0)
        lit = np.maximum(normal[front] @ LAMP / length[front], 0.0) / np.linalg.norm(LAMP)
        shade = AMBIENT + (1 - AMBIENT) * lit
        colors = shade[:, None] * np.array(part.color)
        for triangle, color in zip(triangles[front], colors, strict=True):
            self._fill(triangle, color, depth, target)

    def _creases(self, part: Shown, view: View, depth: FloatArray) -> None:
        for ends in _points(part, view)[part.mesh.crease]:
            self._line(ends, depth)

    def _to_px(self, points: FloatArray) -> FloatArray:
        return (points[..., :2] - self._low) * self._scale

    def _fill(
        self, triangle: FloatArray, color: FloatArray, depth: FloatArray, target: FloatArray
    ) -> None:
        px = self._to_px(triangle)
        low = np.maximum(np.floor(px.min(axis=0)).astype(int), 0)
        high = np.minimum(np.ceil(px.max(axis=0)).astype(int) + 1, depth.shape[::-1])
        (ax, ay), (bx, by), (cx, cy) = px
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area <= 0 or (high <= low).any():
            return
        x = np.arange(low[0], high[0]) + 0.5
        y = (np.arange(low[1], high[1]) + 0.5)[:, None]
        second = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
        third = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
        first = 1 - second - third
        here = first * triangle[0, 2] + second * triangle[1, 2] + third * triangle[2, 2]
        rows, columns = slice(low[1], high[1]), slice(low[0], high[0])
        margin = -1e-9
        wins = (first >= margin) & (second >= margin) & (third >= margin)
        wins &= here > depth[rows, columns]
        depth[rows, columns][wins] = here[wins]
        target[rows, columns][wins] = color

    def _line(self, ends: FloatArray, depth: FloatArray) -> None:
        px = self._to_px(ends)
        steps = int(np.ceil(np.abs(px[1] - px[0]).max())) + 1
        share = np.linspace(0, 1, steps)[:, None]
        x, y = np.floor(px[0] + share * (px[1] - px[0])).astype(int).T
        high = ends[0, 2] + share[:, 0] * (ends[1, 2] - ends[0, 2]) + LINE_LIFT_MM
        for dx, dy in ((0, 0), (1, 0), (0, 1)):
            column, row = x + dx, y + dy
            inside = (column >= 0) & (row >= 0)
            inside &= (column < depth.shape[1]) & (row < depth.shape[0])
            column, row = column[inside], row[inside]
            seen = high[inside] >= depth[row, column]
            self._color[row[seen], column[seen]] = LINE
