"""The bodies that touch the skin, as height fields below their deepest point.

Coordinates are mm in the skin's frame, from the indenter's reference point (its pose). Heights are
zero at the deepest point and negative elsewhere. A soft body has a compliance in series with that
of the gel: an incompressible layer on a rigid core.
"""

import functools
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from spikingtac.errors import named
from spikingtac.schema import build, require_within
from spikingtac.types import FloatArray

LENGTH_MM = (0.01, 1e3)  # Valid lengths of a body, mm.
NO_SURFACE_MM = -1e3  # Height where the body has no surface, far away from any skin, mm.


@dataclass(frozen=True, kw_only=True)
class SoftLayer:
    """Compliance of a soft body, as a bonded incompressible layer.

    Attributes:
        shear_modulus_kpa: Shear modulus, kPa.
        thickness_mm: Thickness over the rigid core, mm.
    """

    shear_modulus_kpa: float
    thickness_mm: float

    def __post_init__(self) -> None:
        require_within(self, shear_modulus_kpa=(0.1, 1e6), thickness_mm=(0.1, 100.0))


@dataclass(frozen=True, kw_only=True)
class Compliant:
    """What all bodies have.

    Attributes:
        soft: Compliance of the body, or None if it is rigid.
    """

    soft: SoftLayer | None = None


@dataclass(frozen=True, kw_only=True)
class Ellipsoid(Compliant):
    """A ball, a finger tip or a spoon's head: an ellipsoid in any orientation.

    It is given by its curvature at the deepest point.

    Attributes:
        radius_x_mm: Radius of curvature along its own x, mm.
        radius_y_mm: Radius of curvature along its own y, mm.
        half_height_mm: Semi-axis along the normal, mm; None takes ``radius_x_mm`` (a ball).
    """

    radius_x_mm: float = 4.0
    radius_y_mm: float = 4.0
    half_height_mm: float | None = None

    def __post_init__(self) -> None:
        require_within(self, radius_x_mm=LENGTH_MM, radius_y_mm=LENGTH_MM, half_height_mm=LENGTH_MM)

    @functools.cached_property
    def _squares_mm2(self) -> FloatArray:
        height = self.half_height_mm or self.radius_x_mm
        # At the pole of an ellipsoid with semi-axes (a, b, c) the curvature radii are a²/c, b²/c.
        return np.array((self.radius_x_mm * height, self.radius_y_mm * height, height**2))

    def heights_mm(self, x_mm: FloatArray, y_mm: FloatArray, rotation: FloatArray) -> FloatArray:
        """Return the surface's height below the deepest point, mm (zero or negative).

        Args:
            x_mm: Offsets from the reference point to the right, mm, any shape.
            y_mm: Offsets downwards in the image, mm, same shape.
            rotation: ``(3, 3)`` orientation of the body.
        """
        m = (rotation / self._squares_mm2) @ rotation.T
        linear = m[0, 2] * x_mm + m[1, 2] * y_mm
        rest = m[0, 0] * x_mm**2 + 2.0 * m[0, 1] * x_mm * y_mm + m[1, 1] * y_mm**2 - 1.0
        root = linear**2 - m[2, 2] * rest
        top = (np.sqrt(np.maximum(root, 0.0)) - linear) / m[2, 2]
        return np.where(root > 0.0, top + self.center_mm(rotation), NO_SURFACE_MM)

    def center_mm(self, rotation: FloatArray) -> float:
        """Return the height of the point about which the body turns, mm (zero or negative)."""
        return -math.sqrt(float(rotation[2] ** 2 @ self._squares_mm2))


@dataclass(frozen=True, kw_only=True)
class Punch(Compliant):
    """A flat punch with a rounded rim. A tilt turns its face into an inclined plane.

    Attributes:
        radius_mm: Outer radius, mm.
        rim_mm: Radius of the rounded rim, mm (the broken edge of a machined punch).
    """

    radius_mm: float = 3.0
    rim_mm: float = 0.5

    def __post_init__(self) -> None:
        require_within(self, radius_mm=LENGTH_MM, rim_mm=(0.0, self.radius_mm))

    def heights_mm(self, x_mm: FloatArray, y_mm: FloatArray, rotation: FloatArray) -> FloatArray:
        """Return the surface's height below the deepest point; see :class:`Ellipsoid`."""
        flat = self.radius_mm - self.rim_mm
        plane = _plane_mm(x_mm, y_mm, rotation)
        rim = _arc_mm(np.maximum(np.hypot(x_mm, y_mm) - flat, 0.0), self.rim_mm)
        return plane + rim + self.center_mm(rotation)

    def center_mm(self, rotation: FloatArray) -> float:
        """Return the face centre's height below the deepest point; see :class:`Ellipsoid`."""
        flat = self.radius_mm - self.rim_mm
        return -flat * math.hypot(rotation[0, 2], rotation[1, 2]) / rotation[2, 2]


@dataclass(frozen=True, kw_only=True)
class Rods(Compliant):
    """Parallel rods with round ends that lie in the gel: a comb's teeth, or one probe.

    Heights are of second order in a tilt.

    Attributes:
        count: Number of rods.
        pitch_mm: Distance between neighbours, along the body's x, mm.
        radius_mm: Radius of a rod, mm.
        length_mm: Length along the body's y, mm, without the round ends.
    """

    count: int = 6
    pitch_mm: float = 2.0
    radius_mm: float = 0.5
    length_mm: float = 6.0

    def __post_init__(self) -> None:
        require_within(self, count=(1, 1000), pitch_mm=LENGTH_MM, radius_mm=LENGTH_MM)
        require_within(self, length_mm=(0.0, 1e3))

    def heights_mm(self, x_mm: FloatArray, y_mm: FloatArray, rotation: FloatArray) -> FloatArray:
        """Return the surface's height below the deepest point; see :class:`Ellipsoid`."""
        plane = _plane_mm(x_mm, y_mm, rotation)
        across = rotation[0, 0] * x_mm + rotation[1, 0] * y_mm + rotation[2, 0] * plane
        along = rotation[0, 1] * x_mm + rotation[1, 1] * y_mm + rotation[2, 1] * plane
        last = 0.5 * (self.count - 1)
        rod = np.clip(np.round(across / self.pitch_mm + last), 0, self.count - 1) - last
        beyond = np.maximum(np.abs(along) - 0.5 * self.length_mm, 0.0)
        distance = np.hypot(across - rod * self.pitch_mm, beyond)
        return plane + _arc_mm(distance, self.radius_mm) + self.center_mm(rotation)

    def center_mm(self, rotation: FloatArray) -> float:
        """Return the middle's height below the deepest point; see :class:`Ellipsoid`."""
        corner = np.array([0.5 * (self.count - 1) * self.pitch_mm, 0.5 * self.length_mm])
        return -float(np.abs(rotation[2, :2]) @ corner)


def _plane_mm(x_mm: FloatArray, y_mm: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return the height of the plane through the origin that is normal to the body's axis."""
    return -(rotation[0, 2] * x_mm + rotation[1, 2] * y_mm) / rotation[2, 2]


def _arc_mm(distance_mm: FloatArray, radius_mm: float) -> FloatArray:
    """Return the height of a circular arc at a distance from its top, mm (zero or negative)."""
    root = np.sqrt(np.maximum(radius_mm**2 - distance_mm**2, 0.0)) - radius_mm
    return np.where(distance_mm < radius_mm, root, NO_SURFACE_MM)


Indenter = Ellipsoid | Punch | Rods  # A body that can be pressed into the skin.


@dataclass(frozen=True, kw_only=True)
class IndenterConfig:
    """Name of a body, and those of its settings that differ from the defaults.

    Attributes:
        kind: Name in :data:`INDENTERS`.
        settings: Table of the body's settings.
    """

    kind: str = "ball"
    settings: dict[str, Any] = field(default_factory=dict)


# The pulp of a finger tip is a layer over bone (the middle of 20 to 50 kPa).
_PULP = {"shear_modulus_kpa": 30.0, "thickness_mm": 6.0}

# Name -> body and its own settings. The finger's radius is that of an adult index (6 to 8 mm), the
# spoon that of a table.
INDENTERS: dict[str, tuple[type[Ellipsoid] | type[Rods] | type[Punch], dict[str, Any]]] = {
    "ball": (Ellipsoid, {}),
    "finger": (Ellipsoid, {"radius_x_mm": 7.0, "radius_y_mm": 7.0, "soft": _PULP}),
    "spoon": (Ellipsoid, {"radius_x_mm": 15.0, "radius_y_mm": 10.0, "half_height_mm": 8.0}),
    "comb": (Rods, {}),
    "punch": (Punch, {}),
    "probe": (Rods, {"count": 1, "radius_mm": 4.0, "length_mm": 14.0}),  # lies, as when grasped
}


def make_indenter(config: IndenterConfig) -> Indenter:
    """Return an indenter by name.

    Raises:
        ConfigError: The name or a setting is unknown. The message names the nearest valid one.
    """
    body, own = named(INDENTERS, config.kind, "indenter")
    return build(body, own | config.settings, f"indenter {config.kind!r}")
