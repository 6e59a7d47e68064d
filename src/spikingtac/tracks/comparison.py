"""Two tracks of the same markers, or tracks and a truth: how far they are apart."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError, require_type
from spikingtac.tracks.tracks import Tracks
from spikingtac.types import FloatArray, one_line

LOADED = "Tracks.load('tracks.npz')"  # How tracks are made, for errors.


@dataclass(frozen=True)
class Comparison:
    """The distances of the same markers at the same times.

    Attributes:
        t_us: ``(n,)`` times of the first tracks within the span of both, us.
        distance_px: ``(n, m)`` distance of each marker, px.
        coasted: ``(n, m)`` True where the first tracks predicted a position.
        distance_mm: ``(n, m)`` the same on the skin, mm, or None where the scale is not known.
        truth: Whether the distance is that from a truth, an error; otherwise it is a difference.
    """

    t_us: NDArray[np.int64]
    distance_px: FloatArray
    coasted: NDArray[np.bool_]
    distance_mm: FloatArray | None = None
    truth: bool = False

    __repr__ = one_line

    @property
    def word(self) -> str:
        """What the distance is called: ``error``, or ``difference`` where nobody knows a truth."""
        return "error" if self.truth else "difference"

    def summary(self) -> dict[str, Any]:
        """Return the figures over all markers and times.

        Returns:
            ``markers``, ``estimates``, ``error_mean_px``, ``error_p50_px``, ``error_p95_px``,
            ``error_max_px``, ``error_seen_mean_px`` (without coasted markers), ``worst_marker``
            (of the largest mean) and ``error_mean_mm``; None where unknown. Of two tracks,
            ``difference`` stands in the place of ``error``.
        """
        p50_px, p95_px = np.percentile(self.distance_px, (50, 95))
        seen = self.distance_px[~self.coasted]
        figures = {
            "mean_px": float(self.distance_px.mean()),
            "p50_px": float(p50_px),
            "p95_px": float(p95_px),
            "max_px": float(self.distance_px.max()),
            "seen_mean_px": float(seen.mean()) if len(seen) else None,
            "mean_mm": None if self.distance_mm is None else float(self.distance_mm.mean()),
        }
        return {
            "markers": self.distance_px.shape[1],
            "estimates": len(self.t_us),
            **{f"{self.word}_{name}": value for name, value in figures.items()},
            "worst_marker": int(self.distance_px.mean(axis=0).argmax()),
        }

    def by_marker(self) -> list[dict[str, Any]]:
        """Return ``marker``, and mean and 95th percentile as in :meth:`summary`, of each marker."""
        means, high = self.distance_px.mean(axis=0), np.percentile(self.distance_px, 95, axis=0)
        mean, p95 = f"{self.word}_mean_px", f"{self.word}_p95_px"
        return [
            {"marker": marker, mean: float(middle), p95: float(far)}
            for marker, (middle, far) in enumerate(zip(means, high, strict=True))
        ]


def compare_tracks(one: Tracks, other: Tracks) -> Comparison:
    """Compare the given positions of two tracks at the times of the first.

    Those of the other are interpolated linearly between its times.

    Raises:
        ConfigError: They have other numbers of markers, or no time in common, or are no tracks.
    """
    for tracks in (one, other):
        require_type(tracks, Tracks, LOADED)
    return _compared(one, one.position_px, other.t_us, other.position_px)


def compare_with_truth(one: Tracks, t_us: NDArray[Any], position_px: NDArray[Any]) -> Comparison:
    """Compare the detected positions of tracks, before any output law, with a ground truth.

    Args:
        one: The tracks.
        t_us: ``(k,)`` times of the positions, increasing, us.
        position_px: ``(k, m, 2)`` the positions, px.

    Raises:
        ConfigError: They have other numbers of markers, or no time in common, or are no tracks; or
            a position is no finite number.
    """
    require_type(one, Tracks, LOADED)
    return replace(_compared(one, one.detected_px, t_us, position_px), truth=True)


def _compared(
    one: Tracks, own_px: NDArray[Any], t_us: NDArray[Any], position_px: NDArray[Any]
) -> Comparison:
    t_us, position_px = np.asarray(t_us), np.asarray(position_px)
    needed = t_us.size, own_px.shape[1], 2
    if t_us.ndim != 1 or position_px.shape != needed:
        raise ConfigError(
            f"the other's positions are {position_px.shape}, needed are {needed}: times, markers, "
            "x and y; compare tracks of the same sensor"
        )
    for row, marker, _ in np.argwhere(~np.isfinite(position_px))[:1].tolist():
        raise ConfigError(
            f"marker {marker} has no finite position at {t_us[row]} us in the other; leave out "
            "such times, so that the ones around them count"
        )
    common = (one.t_us >= t_us[0]) & (one.t_us <= t_us[-1]) if len(t_us) else np.zeros(0, bool)
    if not common.any():
        raise ConfigError("the two have no time in common; compare tracks of the same recording")
    at_us = one.t_us[common]
    columns = position_px.reshape(len(t_us), -1).T
    expected = np.stack([np.interp(at_us, t_us, column) for column in columns], axis=1)
    expected = expected.reshape(len(at_us), *needed[1:])
    own, scale = own_px[common], one.skin_scale
    return Comparison(
        t_us=at_us,
        distance_px=np.linalg.norm(own - expected, axis=2),
        coasted=one.coasted[common],
        distance_mm=None
        if scale is None
        else np.linalg.norm(scale.to_mm(own) - scale.to_mm(expected), axis=2),
    )
