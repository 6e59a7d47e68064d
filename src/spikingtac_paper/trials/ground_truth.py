"""The true marker positions of a recording, at any time."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import RecordingError
from spikingtac.events import load_arrays

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
        free_us: ``(k, 2)`` time spans without contact: from each release to the next touch, the
            last one to the end, us.
    """

    t_us: NDArray[np.int64]
    marker_px: NDArray[np.float64]
    reference_px: NDArray[np.float64]
    radius_px: NDArray[np.float64]
    released_us: int
    free_us: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 2), np.int64))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a ``truth.npz``.

        Raises:
            RecordingError: The file is missing, damaged, or lacks a column.
        """
        try:
            return cls.of(load_arrays(path, "ground truth"))
        except (RecordingError, ValueError, IndexError, KeyError) as error:
            raise RecordingError(
                f"{str(path)!r} holds no ground truth ({error}); "
                "render the recording again with: spikingtac simulate SCENE -o FOLDER"
            ) from error

    @classmethod
    def of(cls, columns: dict[str, NDArray[Any]]) -> Self:
        """Build the truth from the columns of a ``truth.npz``."""
        t_us = columns["marker_t_us"].astype(np.int64)
        released_us, free_us = _contact_times(columns, int(t_us[-1]))
        return cls(
            t_us=t_us,
            marker_px=columns["marker_px"].astype(np.float64),
            reference_px=columns["reference_px"].astype(np.float64),
            radius_px=columns["radius_px"].astype(np.float64),
            released_us=released_us,
            free_us=free_us,
        )

    def at(self, t_us: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the true positions ``(k, m, 2)`` at some times, px; constant beyond the ends."""
        after = np.clip(np.searchsorted(self.t_us, t_us), 1, len(self.t_us) - 1)
        span_us = self.t_us[after] - self.t_us[after - 1]
        fraction = np.clip((t_us - self.t_us[after - 1]) / span_us, 0.0, 1.0)[:, None, None]
        return self.marker_px[after - 1] * (1.0 - fraction) + self.marker_px[after] * fraction


def _contact_times(columns: dict[str, NDArray[Any]], last_us: int) -> tuple[int, NDArray[np.int64]]:
    """Return the end of the last contact, us, and the spans ``(k, 2)`` after each release, us."""
    if "in_contact" in columns:
        touched = columns["in_contact"].astype(np.bool_)
    elif "force_n" in columns:
        touched = np.abs(columns["force_n"]).max(axis=1) > 0.0
    else:
        return last_us - REST_US, np.empty((0, 2), np.int64)
    times_us, change = columns["contact_t_us"], np.diff(touched.astype(np.int8))
    released, touches = np.flatnonzero(change < 0) + 1, np.flatnonzero(change > 0) + 1
    ends_us = np.append(times_us[touches], last_us)
    ends_us = ends_us[np.searchsorted(touches, released, side="right")]
    free_us = np.column_stack([times_us[released], ends_us]).astype(np.int64)
    if not touched.any():
        return last_us - REST_US, free_us
    after = min(int(np.flatnonzero(touched)[-1]) + 1, len(times_us) - 1)
    return int(times_us[after]), free_us
