"""Trajectories of the markers of one recording: the true ones, and a method's estimates."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import RecordingError
from spikingtac.events import load_truth
from spikingtac.types import FloatArray, MarkerFrame

# Where the truth names no contacts, the last second counts as after the release, us.
REST_US = 1_000_000


@dataclass(frozen=True, slots=True)
class GroundTruth:
    """The true trajectories of the markers of one recording.

    Attributes:
        t_us: ``(n,)`` int64 times, us, increasing.
        marker_px: ``(n, m, 2)`` optical centres, px; between the times they move linearly.
        reference_px: ``(m, 2)`` where they rest, px.
        radius_px: ``(m,)`` radii, px.
        released_us: End of the last contact, us.
    """

    t_us: NDArray[np.int64]
    marker_px: FloatArray
    reference_px: FloatArray
    radius_px: FloatArray
    released_us: int

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a ``truth.npz``.

        Raises:
            RecordingError: The file is missing, damaged, or lacks a column.
        """
        needed = ("marker_t_us", "marker_px", "reference_px", "radius_px")
        columns = load_truth(Path(path), needed)
        if not len(columns["marker_t_us"]):
            raise RecordingError(f"{str(path)!r} holds no times")
        return cls.of(columns)

    @classmethod
    def of(cls, columns: dict[str, NDArray[Any]]) -> Self:
        """Build the truth from the columns of a ``truth.npz``."""
        t_us = columns["marker_t_us"].astype(np.int64)
        return cls(
            t_us=t_us,
            marker_px=columns["marker_px"].astype(np.float64),
            reference_px=columns["reference_px"].astype(np.float64),
            radius_px=columns["radius_px"].astype(np.float64),
            released_us=_released_us(columns, int(t_us[-1])),
        )

    def at(self, t_us: NDArray[np.int64]) -> FloatArray:
        """Return the true positions ``(k, m, 2)`` at some times, px; constant beyond the ends."""
        return places_at(t_us, self.t_us, self.marker_px)


def places_at(t_us: NDArray[Any], known_us: NDArray[Any], marker_px: FloatArray) -> FloatArray:
    """Return places ``(k, m, 2)`` between those of known times; constant beyond the ends."""
    after = np.clip(np.searchsorted(known_us, t_us), 1, len(known_us) - 1)
    span_us = known_us[after] - known_us[after - 1]
    fraction = np.clip((t_us - known_us[after - 1]) / span_us, 0.0, 1.0)[:, None, None]
    return marker_px[after - 1] * (1.0 - fraction) + marker_px[after] * fraction


def _released_us(columns: dict[str, NDArray[Any]], last_us: int) -> int:
    """Return the end of the last contact, us."""
    touched = np.zeros(0, np.bool_)
    if "in_contact" in columns:
        touched = columns["in_contact"].astype(np.bool_)
    elif "force_n" in columns:
        touched = np.abs(columns["force_n"]).max(axis=1) > 0.0
    if not touched.any():
        return last_us - REST_US
    times_us = columns["contact_t_us"]
    return int(times_us[min(int(np.flatnonzero(touched)[-1]) + 1, len(times_us) - 1)])


@dataclass(frozen=True, slots=True)
class Prediction:
    """Estimates of one method on one recording.

    Attributes:
        t_us: ``(n,)`` int64 times, us.
        detected_px: ``(n, m, 2)`` float32, the truthful estimate, px.
        position_px: ``(n, m, 2)`` float32, after the method's own law, px.
        reference_px: ``(m, 2)`` the rest positions of the calibration, px.
    """

    t_us: NDArray[np.int64]
    detected_px: NDArray[np.float32]
    position_px: NDArray[np.float32]
    reference_px: FloatArray

    @classmethod
    def collect(cls, frames: Iterable[MarkerFrame], reference_px: FloatArray, every: int) -> Self:
        """Keep every ``every``-th frame of a tracked stream, and the last one.

        Args:
            frames: The estimates in order of time.
            reference_px: ``(m, 2)`` rest positions, px.
            every: Distance of the frames that are kept; 1 keeps all.
        """
        kept: list[MarkerFrame] = []
        for number, frame in enumerate(frames):
            # The last frame takes the place of one that would not be kept.
            kept[number // every + (number % every > 0) :] = [frame]
        t_us = np.array([frame.t_us for frame in kept], np.int64)
        detected, position = (
            np.array([getattr(frame, name) for frame in kept], np.float32)
            for name in ("detected_px", "position_px")
        )
        shape = (-1, len(reference_px), 2)
        return cls(t_us, detected.reshape(shape), position.reshape(shape), reference_px)
