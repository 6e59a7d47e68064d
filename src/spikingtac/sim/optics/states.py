"""The two states that pass between the parts of the twin: gel -> optics -> event camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim.optics.contact_patch import NO_PATCH, ContactPatch


@dataclass(frozen=True, slots=True)
class SkinState:
    """The markers on the skin and the load at one time.

    The frame is that of the image, in mm: x right, y down, origin at the optical axis. z points
    towards the camera, so that an indentation is positive.

    Attributes:
        t_us: Time, us.
        marker_mm: ``(m, 3)`` positions of the markers, mm.
        gradient: ``(m, 2, 2)`` in-plane deformation gradient d(deformed xy) / d(rest xy).
        force_n: ``(3,)`` force of the indenter on the skin, N.
        torque_n_mm: ``(3,)`` its moment about the origin of the frame, N mm.
        pose_mm: ``(3,)`` reference point of the indenter, mm.
        in_contact: True where any pressure acts.
        patch: Which cells of the skin are touched; empty where the model has no cells.
    """

    t_us: int
    marker_mm: NDArray[np.float64]
    gradient: NDArray[np.float64]
    force_n: NDArray[np.float64]
    torque_n_mm: NDArray[np.float64]
    pose_mm: NDArray[np.float64]
    in_contact: bool
    patch: ContactPatch = NO_PATCH


@dataclass(frozen=True, slots=True)
class MarkerImage:
    """Image of a :class:`SkinState` on the sensor.

    Attributes:
        t_us: Time, us.
        center_px: ``(m, 2)`` marker centres on the sensor, px.
        shape: ``(m, 2, 2)`` maps a pixel's offset from the centre (px) to the undeformed disc: the
            marker covers the pixels with ``|shape @ offset| < radius_px``.
        radius_px: ``(m,)`` radii of the undeformed discs on the sensor, px; 0 where a marker is
            missing.
        chord: ``(m, 3)`` chords of broken discs, or None if all are whole. The paint is missing
            where ``chord[:, :2] @ (shape @ offset) > chord[:, 2]``, with unit ``chord[:, :2]`` and
            ``chord[:, 2]`` in px, infinite for a whole disc.
    """

    t_us: int
    center_px: NDArray[np.float64]
    shape: NDArray[np.float64]
    radius_px: NDArray[np.float64]
    chord: NDArray[np.float64] | None = None
