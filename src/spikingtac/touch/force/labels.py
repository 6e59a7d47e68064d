"""Wrenches from a file of their own: a force sensor's CSV, or the truth of the twin."""

from __future__ import annotations

import csv
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from spikingtac.errors import RecordingError
from spikingtac.touch.force.series import COMPONENTS, WrenchSeries

Field = NDArray[np.float64]

US_PER_S = 1e6
N_MM_PER_NM = 1e3

# Step of the time in which two clocks are compared, us: a fifth of the fastest press (ours).
STEP_US = 5_000

# Motion and force that agree less than this are of different recordings (ours).
LEAST_CORRELATION = 0.6


class WrenchLabels(NamedTuple):
    """A wrench over time.

    Attributes:
        t_us: ``(k,)`` times, us.
        wrench: ``(k, c)`` forces in N, moments in Nm.
        same_clock: True where the times are those of the displacements.
    """

    t_us: NDArray[np.int64]
    wrench: Field
    same_clock: bool


def load_labels(path: str | Path) -> WrenchLabels:
    """Read ``truth.npz``, a simulation's folder, or a CSV with a header.

    The CSV names its columns ``t_us`` or ``t_s``, ``fx``, ``fy``, ``fz`` (N) and, where all of
    the moments were measured, ``mx``, ``my``, ``mz`` (Nm).

    Raises:
        RecordingError: The file cannot be read or holds no wrench.
    """
    source = Path(path)
    if source.is_dir():
        source = source / "truth.npz"
    return _from_csv(source) if source.suffix.lower() == ".csv" else _from_truth(source)


def labelled(series: WrenchSeries, labels: WrenchLabels) -> WrenchSeries:
    """Return a series with the labels at its times, interpolated; frames outside are left out.

    Where the labels have another clock, their offset is found from the motion first.

    Raises:
        RecordingError: Labels and displacements do not overlap in time.
    """
    if not len(labels.t_us) or not len(series.t_us):
        raise RecordingError(
            f"{series.name}: {len(series.t_us)} frames and {len(labels.t_us)} forces; "
            "there must be some of both"
        )
    t_us = labels.t_us
    if not labels.same_clock:
        t_us = t_us + clock_offset_us(series, labels)
    inside = (series.t_us >= t_us[0]) & (series.t_us <= t_us[-1])
    if not inside.any():
        raise RecordingError(f"{series.name}: no frame lies within the time of its forces")
    columns = [np.interp(series.t_us, t_us, column) for column in labels.wrench.T]
    return replace(series, wrench=np.column_stack(columns)).part(inside)


def clock_offset_us(series: WrenchSeries, labels: WrenchLabels) -> int:
    """Return what must be added to the labels' times to get those of the displacements, us.

    The amount of motion and the amount of force are made uniform in time and correlated. Contacts
    that repeat alike at equal intervals are ambiguous: press once at an odd moment.

    Raises:
        RecordingError: Motion and force do not look alike at any offset.
    """
    moved = np.sqrt((series.displacement**2).sum(axis=2).mean(axis=1))
    pressed = np.sqrt((labels.wrench[:, :3] ** 2).sum(axis=1))
    seen, felt = _uniform(series.t_us, moved), _uniform(labels.t_us, pressed)
    scale = float(np.sqrt((seen**2).sum() * (felt**2).sum()))
    score = correlate(seen, felt) / (scale if scale > 0.0 else 1.0)
    best = int(score.argmax())
    if not score[best] >= LEAST_CORRELATION:
        raise RecordingError(
            f"{series.name}: displacements and forces agree by {score[best]:.2f} at best; "
            "are they of the same recording?"
        )
    steps = best - (len(felt) - 1)
    return int(series.t_us[0]) - int(labels.t_us[0]) + steps * STEP_US


def _uniform(t_us: NDArray[np.int64], values: Field) -> Field:
    even = np.interp(np.arange(t_us[0], t_us[-1] + 1, STEP_US), t_us, values)
    return even - even.mean()


def _from_truth(path: Path) -> WrenchLabels:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            t_us, force = archive["contact_t_us"], archive["force_n"]
            moment = archive["torque_n_mm"] / N_MM_PER_NM if "torque_n_mm" in archive else None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile) as error:
        raise RecordingError(
            f"{str(path)!r} holds no forces: {error}; give a CSV or the truth.npz of a simulation"
        ) from error
    wrench = force if moment is None else np.hstack([force, moment])
    return WrenchLabels(t_us.astype(np.int64), wrench.astype(np.float64), same_clock=True)


def _from_csv(path: Path) -> WrenchLabels:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file)
            names = [str(name).strip().lower() for name in reader.fieldnames or ()]
            table = np.array([[float(value) for value in row.values()] for row in reader])
    except (OSError, UnicodeDecodeError, TypeError, ValueError, csv.Error) as error:
        raise RecordingError(f"cannot read forces from {str(path)!r}: {error}") from error
    clock = next((name for name in ("t_us", "t_s") if name in names), None)
    kept = [name for name in COMPONENTS if name in names]
    if not len(table) or clock is None or kept not in (list(COMPONENTS), list(COMPONENTS[:3])):
        raise RecordingError(
            f"{str(path)!r} needs a header and rows with t_us or t_s, fx, fy, fz, and all of mx, "
            f"my, mz or none; it has {', '.join(names) or 'nothing'}"
        )
    if not np.isfinite(table).all():
        row = 1 + int(np.flatnonzero(~np.isfinite(table).all(axis=1))[0])
        raise RecordingError(f"{str(path)!r}: row {row} has a value that is not a finite number")
    t_us = table[:, names.index(clock)] * (US_PER_S if clock == "t_s" else 1.0)
    if not (np.diff(t_us) > 0).all():
        raise RecordingError(f"{str(path)!r}: its times do not increase")
    wrench = table[:, [names.index(name) for name in kept]]
    return WrenchLabels(np.round(t_us).astype(np.int64), wrench, same_clock=False)
