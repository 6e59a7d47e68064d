"""The values that pass between the parts of the twin: gel -> optics -> event camera -> truth.

The two states that pass between the parts of the twin: gel -> optics -> event camera.

Where a body touches the skin and where it sticks, in a form small enough for a recording.

Ground truth of a simulation beside the events: markers, wrench, patch and pose, in chunks.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Bits = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class ContactPatch:
    """The cells of the skin that a body touches at one time.

    A cell is a piece of the skin: it is named by its place at rest, not by where the body has
    dragged it. Bits follow ``numpy.packbits`` over the cells in rows, so that
    ``numpy.unpackbits(touching).reshape(n, n)`` is the patch.

    Attributes:
        touching: ``(ceil(n² / 8),)`` one bit per cell, set where any pressure acts.
        sticking: ``(ceil(n² / 8),)`` set where the cell touches and does not slip.
    """

    touching: Bits
    sticking: Bits

    @classmethod
    def of(cls, touching: NDArray[np.bool_], sticking: NDArray[np.bool_]) -> ContactPatch:
        """Pack masks of any equal shape."""
        return cls(np.packbits(touching.ravel()), np.packbits(sticking.ravel()))


# What a model without cells knows of its patch.
NO_PATCH = ContactPatch(np.empty(0, np.uint8), np.empty(0, np.uint8))


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


# Longest time between two rows, us.
#
# The camera interpolates the images linearly between the gel's steps. Rows fall on those steps
# and between them, so that linear interpolation of the truth is exact.
ROW_US = 1000


@dataclass(frozen=True, slots=True)
class TruthChunk:
    """Ground truth over a stretch of time.

    Attributes:
        marker_t_us: ``(n,)`` times of the markers' rows, us.
        marker_px: ``(n, m, 2)`` optical centres of the undamaged discs, px.
        contact_t_us: ``(k,)`` times of the rows below, one for each step of the gel, us.
        force_n: ``(k, 3)`` force of the indenter on the skin, N.
        torque_n_mm: ``(k, 3)`` its moment about the optical axis and the skin at rest, N mm.
        touching_cells: ``(k, ceil(n² / 8))`` the cells of the skin that are touched, one bit each
            (:class:`~spikingtac.sim.states.ContactPatch`).
        sticking_cells: ``(k, ceil(n² / 8))`` those that are touched and do not slip.
        pose_mm: ``(k, 3)`` the indenter's reference point, mm (x right, y down, z depth).
        in_contact: ``(k,)`` True where any pressure acts.
        marker_depth_mm: ``(k, m)`` how far the skin is indented under each marker, mm.
        marker_radius_px: ``(k, m)`` radii of circles with the area of the discs on the image, px.
    """

    marker_t_us: NDArray[np.int64]
    marker_px: NDArray[np.float32]
    contact_t_us: NDArray[np.int64]
    force_n: NDArray[np.float64]
    torque_n_mm: NDArray[np.float64]
    touching_cells: NDArray[np.uint8]
    sticking_cells: NDArray[np.uint8]
    pose_mm: NDArray[np.float64]
    in_contact: NDArray[np.bool_]
    marker_depth_mm: NDArray[np.float32]
    marker_radius_px: NDArray[np.float32]

    @classmethod
    def of_step(cls, state: SkinState, now: MarkerImage, then: MarkerImage) -> TruthChunk:
        """Return the truth of one step of the gel, without the first instant of the next step."""
        rows = max(1, -(-(then.t_us - now.t_us) // ROW_US))
        fraction = np.arange(rows)[:, None, None] / rows
        moved = then.center_px - now.center_px
        return cls(
            marker_t_us=now.t_us + (then.t_us - now.t_us) * np.arange(rows, dtype=np.int64) // rows,
            marker_px=(now.center_px + fraction * moved).astype(np.float32),
            contact_t_us=np.array([now.t_us], np.int64),
            force_n=np.array(state.force_n, np.float64)[None],
            torque_n_mm=np.array(state.torque_n_mm, np.float64)[None],
            touching_cells=state.patch.touching[None],
            sticking_cells=state.patch.sticking[None],
            pose_mm=np.array(state.pose_mm, np.float64)[None],
            in_contact=np.array([state.in_contact]),
            marker_depth_mm=state.marker_mm[None, :, 2].astype(np.float32),
            marker_radius_px=image_radius_px(now)[None].astype(np.float32),
        )

    @classmethod
    def concatenate(cls, chunks: Iterable[TruthChunk]) -> TruthChunk:
        """Join chunks that follow each other in time; at least one is needed."""
        kept = list(chunks)
        return cls(*(np.concatenate([getattr(chunk, name) for chunk in kept]) for name in _COLUMNS))


_COLUMNS = tuple(TruthChunk.__dataclass_fields__)


def image_radius_px(image: MarkerImage) -> NDArray[np.float64]:
    """Return the radii ``(m,)`` of circles with the area of the discs on the image, px."""
    return image.radius_px / np.sqrt(np.abs(np.linalg.det(image.shape)))
