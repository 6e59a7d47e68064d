"""Wrenches from a file of their own: a force sensor's CSV, or the truth of the twin."""

from __future__ import annotations

import csv
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import RecordingError
from spikingtac.touch.force.labels.clock_alignment import clock_offset_us
from spikingtac.touch.force.wrench_series import COMPONENTS, WrenchSeries

Field = NDArray[np.float64]

US_PER_S = 1e6
N_MM_PER_NM = 1e3


@dataclass(frozen=True, slots=True)
class WrenchLabels:
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
        t_us = t_us + clock_offset_us(series, labels.t_us, labels.wrench)
    inside = (series.t_us >= t_us[0]) & (series.t_us <= t_us[-1])
    if not inside.any():
        raise RecordingError(f"{series.name}: no frame lies within the time of its forces")
    kept = series.part(inside)
    columns = [np.interp(kept.t_us, t_us, column) for column in labels.wrench.T]
    return WrenchSeries(
        kept.t_us,
        kept.reference,
        kept.displacement,
        np.column_stack(columns),
        kept.unit,
        kept.name,
    )


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
            rows = [[float(value) for value in row.values()] for row in reader]
    except (OSError, UnicodeDecodeError, TypeError, ValueError, csv.Error) as error:
        raise RecordingError(f"cannot read forces from {str(path)!r}: {error}") from error
    missing = [name for name in COMPONENTS[:3] if name not in names]
    if missing or not rows or not {"t_us", "t_s"} & set(names):
        raise RecordingError(
            f"{str(path)!r} needs a header and rows with t_us or t_s, fx, fy and fz; "
            f"it has {', '.join(names) or 'nothing'}"
        )
    given = [name for name in COMPONENTS[3:] if name in names]
    if given and len(given) < len(COMPONENTS) - 3:
        raise RecordingError(
            f"{str(path)!r} has of the moments only {', '.join(given)}; give mx, my and mz, or none"
        )
    table = np.array(rows)
    if not np.isfinite(table).all():
        row = 1 + int(np.flatnonzero(~np.isfinite(table).all(axis=1))[0])
        raise RecordingError(f"{str(path)!r}: row {row} has a value that is not a finite number")
    time = table[:, names.index("t_us")] if "t_us" in names else None
    t_us = time if time is not None else table[:, names.index("t_s")] * US_PER_S
    if not (np.diff(t_us) > 0).all():
        raise RecordingError(f"{str(path)!r}: its times do not increase")
    kept = [names.index(name) for name in COMPONENTS if name in names]
    return WrenchLabels(np.round(t_us).astype(np.int64), table[:, kept], same_clock=False)
