"""Contacts mirrored: a skin whose markers lie symmetrically feels a mirrored contact alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator

from spikingtac.calibration.pitch import marker_pitch_px
from spikingtac.touch.force.regression import NORMAL

Field = NDArray[np.float64]

# Distance between mirrored markers and the nearest ones, in pitches, up to which a layout is
# symmetric (ours: 0.17 in data/force).
SYMMETRIC_PITCHES = 0.35

# Least R2 of the shear forces on the mean displacement: with less the frames are not known.
FOLLOWS_SHARE = 0.6

# Of a mirrored frame beside a measured one (ours: 0.15 to 0.3 are alike; mean R2 of the normal
# force in parts of the series of data/force .885, without mirrored frames .877).
WEIGHT = 0.2


def with_mirrored(
    reference: Field, fields: Field, wrench: Field
) -> tuple[Field, Field, NDArray[np.float64]]:
    """Return frames and their mirror images (x to -x), with the weight of each component.

    Where layout or labels are not known to be symmetric there are no images. The moments' point of
    reference is unknown, so images teach none.

    Args:
        reference: ``(m, 2)`` markers at rest.
        fields: ``(n, 2 m)`` displacements.
        wrench: ``(n, c)`` forces from their own zero, and moments.
    """
    known = np.ones(wrench.shape)
    across = _force_mirror(fields, wrench[:, :NORMAL])
    middle = reference[:, 0].mean()
    mirrored = np.column_stack([2.0 * middle - reference[:, 0], reference[:, 1]])
    away = np.sqrt(((mirrored[:, None] - reference) ** 2).sum(axis=2)).min(axis=1)
    asymmetry = float(np.sqrt((away**2).mean())) / marker_pitch_px(reference)
    if across is None or asymmetry > SYMMETRIC_PITCHES:
        return fields, wrench, known
    moved = fields.reshape(len(fields), -1, 2)
    at_mirrored = RBFInterpolator(reference, np.eye(len(reference)))(mirrored)
    image = np.einsum("kj,njc->nkc", at_mirrored, moved) * np.array([-1.0, 1.0])
    force = np.zeros(wrench.shape)
    force[:, :NORMAL], force[:, NORMAL] = wrench[:, :NORMAL] @ across.T, wrench[:, NORMAL]
    weight = np.zeros(wrench.shape)
    weight[:, : NORMAL + 1] = WEIGHT
    return (
        np.concatenate([fields, image.reshape(fields.shape)]),
        np.concatenate([wrench, force]),
        np.concatenate([known, weight]),
    )


def _force_mirror(fields: Field, shear: Field) -> Field | None:
    """Return the mirror ``(2, 2)`` of x in the labels' frame, which may be turned to the markers'.

    None where the shear forces do not follow the mean displacement.
    """
    mean = fields.reshape(len(fields), -1, 2).mean(axis=1)
    rows = np.column_stack([mean, np.ones(len(mean))])
    found = np.linalg.lstsq(rows, shear, rcond=None)[0]
    left = ((shear - rows @ found) ** 2).sum() / ((shear - shear.mean(axis=0)) ** 2).sum()
    if not left < 1.0 - FOLLOWS_SHARE:
        return None
    u, _, vt = np.linalg.svd(found[:2].T)
    turn = u @ vt
    return np.asarray(turn @ np.diag([-1.0, 1.0]) @ turn.T)
