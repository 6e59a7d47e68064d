"""Kabsch alignment: the rigid motion between two sets of points, with its degenerate cases."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spikingtac.types import FloatArray

RANK_TOLERANCE = 1e-9
"""Singular values below this fraction of the largest one count as zero."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """A proper rigid motion, ``aligned = rotation @ point + translation``.

    Attributes:
        rotation: ``(d, d)`` with determinant +1.
        translation: ``(d,)``, in the unit of the points.
        rmse: Root mean square distance after the motion, in the unit of the points.
        determined: False where the points do not determine the rotation (too few, or collinear in
            3-D); it is then the smallest possible one.
    """

    rotation: FloatArray
    translation: FloatArray
    rmse: float
    determined: bool

    def apply(self, points: FloatArray) -> FloatArray:
        """Return points ``(n, d)`` after the motion."""
        return points @ self.rotation.T + self.translation


def align(points: FloatArray, onto: FloatArray) -> Alignment:
    """Return the rotation and translation that minimise the squared distances (Kabsch 1976).

    The determinant is +1: a mirrored set is never reached by a reflection. Where the points do not
    determine the rotation, the one nearest to the identity is returned.

    Args:
        points: ``(n, d)`` points, d = 2 or 3.
        onto: ``(n, d)`` the points to reach.

    Raises:
        ValueError: The shapes differ, no point is given, or a value is not finite.

    Source: Kabsch, doi:10.1107/S0567739476001873; sign handling as Umeyama, doi:10.1109/34.88573.
    """
    points, onto = np.asarray(points, np.float64), np.asarray(onto, np.float64)
    if points.shape != onto.shape or points.ndim != 2 or points.shape[1] not in (2, 3):
        raise ValueError(
            f"got shapes {points.shape} and {onto.shape}; both must be (n, 2) or (n, 3)"
        )
    if len(points) == 0 or not (np.isfinite(points).all() and np.isfinite(onto).all()):
        raise ValueError("alignment needs at least one point, and finite coordinates")
    middle, goal = points.mean(axis=0), onto.mean(axis=0)
    rotation, determined = _rotation((points - middle).T @ (onto - goal))
    translation = goal - rotation @ middle
    left = points @ rotation.T + translation - onto
    rmse = float(np.sqrt((left**2).sum(axis=1).mean()))
    return Alignment(rotation, translation, rmse, determined)


def _rotation(covariance: FloatArray) -> tuple[FloatArray, bool]:
    """Return the best rotation for a cross-covariance ``(d, d)``, and whether it is unique."""
    dimension = len(covariance)
    u, size, vt = np.linalg.svd(covariance)
    rank = int((size > RANK_TOLERANCE * size[0]).sum()) if size[0] > 0.0 else 0
    if rank == 0:
        return np.eye(dimension), False
    if rank < dimension - 1:
        return _shortest_turn(u[:, 0], vt[0]), False
    sign = np.ones(dimension)
    sign[-1] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    unique = bool(sign[-1] > 0.0 or size[-2] - size[-1] > RANK_TOLERANCE * size[0])
    return vt.T @ np.diag(sign) @ u.T, unique


def _shortest_turn(source: FloatArray, goal: FloatArray) -> FloatArray:
    """Return the smallest rotation ``(3, 3)`` that takes one unit vector to another."""
    axis, cosine = np.cross(source, goal), float(source @ goal)
    if cosine < -1.0 + RANK_TOLERANCE:  # opposite: half a turn about any axis across
        across = np.eye(3)[np.argmin(np.abs(source))]
        across = across - (across @ source) * source
        across /= np.linalg.norm(across)
        return 2.0 * np.outer(across, across) - np.eye(3)
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + skew + skew @ skew / (1.0 + cosine)
