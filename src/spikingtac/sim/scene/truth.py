"""Ground truth of a simulation beside the events: markers, wrench, patch and pose, in chunks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim.optics.states import MarkerImage, SkinState

ROW_US = 1000
"""Longest time between two rows, us.

The camera interpolates the images linearly between the gel's steps. Rows fall on those steps and
between them, so that linear interpolation of the truth is exact.
"""


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
            (:class:`~spikingtac.sim.optics.contact_patch.ContactPatch`).
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
