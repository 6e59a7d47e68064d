"""A robot's poses on a sensor's clock."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import replacing
from spikingtac.errors import RecordingError
from spikingtac.events.align.shared_motion import STEP_US, Course
from spikingtac.events.clock import TimeMap

US_PER_S = 1e6

# Name of a time column -> its unit, us.
TIME_COLUMNS = {"t_us": 1.0, "t_ns": 1e-3, "t_ms": 1e3, "t_s": US_PER_S, "timestamp": US_PER_S}

# Value that the 95th percentile of the speeds gets: that of a lively millisecond of events.
LIVELY = 100.0
MOST_S = 86_400.0  # Longest log whose motion is compared: a day.


@dataclass(frozen=True)
class Poses:
    """Poses over time.

    Attributes:
        t_us: ``(n,)`` int64 times, us, in order.
        state: ``(n, k)`` values; the first three are a position.
        names: Names of the k columns.
    """

    t_us: NDArray[np.int64]
    state: NDArray[np.float64]
    names: tuple[str, ...]

    def on(self, time_map: TimeMap) -> Poses:
        """Return the same poses with their times on another clock."""
        return replace(self, t_us=time_map(self.t_us))

    def course(self) -> Course:
        """Return how fast the position moves over time, for a comparison with events.

        Raises:
            RecordingError: There is no position, or it never moves.
        """
        span_us = int(self.t_us[-1] - self.t_us[0])
        if self.state.shape[1] < 3 or span_us < STEP_US or span_us > MOST_S * US_PER_S:
            raise RecordingError(
                "poses are compared with events by the motion of their first three columns, over "
                "a millisecond to a day"
            )
        grid_us = np.arange(self.t_us[0], self.t_us[-1] + 1, STEP_US)
        place = np.column_stack([np.interp(grid_us, self.t_us, self.state[:, k]) for k in range(3)])
        speed = np.sqrt((np.gradient(place, axis=0) ** 2).sum(axis=1))
        quick = float(np.percentile(speed, 95))
        if quick <= 0.0:
            raise RecordingError("the poses hardly move: there is no motion to compare with events")
        return Course(int(self.t_us[0]), speed * (LIVELY / quick))

    def save(self, path: Path) -> None:
        """Write ``.npz`` with ``t_us``, ``state`` and ``names``; ``export --log`` takes it."""
        with replacing(path) as whole, whole.open("wb") as file:
            np.savez(file, t_us=self.t_us, state=self.state, names=np.array(self.names))


def load_poses(path: Path) -> Poses:
    """Read a CSV with a header: one time column (``t_us``, ``t_s`` ...), and columns of numbers.

    Raises:
        RecordingError: It cannot be read as that.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = [row for row in csv.reader(file) if row]
        names = [name.strip() for name in rows[0]]
        values = np.array([[float(cell) for cell in row] for row in rows[1:]])
    except (OSError, ValueError, IndexError, csv.Error) as error:
        raise _no_poses(path, str(error)) from error
    found = [name for name in names if name in TIME_COLUMNS]
    if len(found) != 1:
        raise _no_poses(path, f"its columns are {', '.join(names)}")
    if values.ndim != 2 or values.shape[1] != len(names) or not np.isfinite(values).all():
        raise _no_poses(path, "a row is short, or holds no finite number")
    column = names.index(found[0])
    t_us = np.rint(values[:, column] * TIME_COLUMNS[found[0]]).astype(np.int64)
    if (np.diff(t_us) < 0).any():
        raise _no_poses(path, "its times run backwards; sort the rows")
    others = [k for k in range(len(names)) if k != column]
    return Poses(t_us, values[:, others], tuple(names[k] for k in others))


def _no_poses(path: Path, why: str) -> RecordingError:
    return RecordingError(
        f"{str(path)!r} is no table of poses: {why}; it needs a header with one time column "
        f"({', '.join(TIME_COLUMNS)}) and columns of numbers, such as x_mm,y_mm,z_mm"
    )
