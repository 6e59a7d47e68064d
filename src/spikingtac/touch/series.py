"""Displacements of markers over time, with the wrench that made them where it was measured.

The wrench stands in the same file, in a force sensor's CSV, or in the truth of a simulation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import PATH, RecordingError, require_type
from spikingtac.events.align import load_poses
from spikingtac.events.formats.array_file import load_arrays, load_truth
from spikingtac.types import US_PER_DAY, FloatArray, one_line

Times = NDArray[np.int64]

# Columns of a wrench: forces in N, then moments in Nm.
COMPONENTS = ("fx", "fy", "fz", "mx", "my", "mz")
N_MM_PER_NM = 1e3

# Step of the time in which two clocks are compared, us: a fifth of the fastest press.
STEP_US = 5_000
LEAST_CORRELATION = 0.6  # Motion and force that agree less are of different recordings.


@dataclass(frozen=True, slots=True)
class WrenchSeries:
    """One uninterrupted series of labelled contacts.

    Attributes:
        t_us: ``(n,)`` times, us.
        reference: ``(m, d)`` markers at rest, in ``unit``.
        displacement: ``(n, m, d)`` displacements, in ``unit``; d is 2 (in the image) or 3.
        wrench: ``(n, c)`` forces in N and moments in Nm, the first c of :data:`COMPONENTS`; no
            columns where nothing was measured. In whichever frame the labels have.
        unit: ``"mm"`` or ``"px"``.
        name: Where it came from, for messages.
    """

    t_us: NDArray[np.int64]
    reference: FloatArray
    displacement: FloatArray
    wrench: FloatArray
    unit: str
    name: str = "series"

    __repr__ = one_line

    def __post_init__(self) -> None:
        frames, moved, wrench = len(self.t_us), self.displacement, self.wrench
        fits = moved.shape == (frames, *self.reference.shape) and moved.shape[2:] in ((2,), (3,))
        rules = {
            f"{frames} times, markers of {self.reference.shape}, displacements of {moved.shape}; "
            "they must be (times, markers, coordinates), 2 or 3 coordinates in mm or px": fits
            and self.unit in ("mm", "px"),
            f"the wrench is {wrench.shape}, it must have {frames} rows and at most the columns "
            f"{', '.join(COMPONENTS)}": len(wrench) == frames and wrench.shape[1:] <= (6,),
            "displacements are not finite; leave such rows out": np.isfinite(moved).all(),
            "forces are not finite; leave such rows out": np.isfinite(wrench).all(),
            "the times run backwards; sort the rows by t_us": (np.diff(self.t_us) >= 0).all(),
        }
        for wrong, kept in rules.items():
            if not kept:
                raise RecordingError(f"{self.name}: {wrong}")

    def in_image(self) -> WrenchSeries:
        """Return the series without depth: what one camera sees."""
        return replace(
            self, reference=self.reference[:, :2], displacement=self.displacement[..., :2]
        )

    def part(self, rows: NDArray[Any]) -> WrenchSeries:
        """Return the rows of a mask or of indices as a series of their own."""
        columns = {name: getattr(self, name)[rows] for name in ("t_us", "displacement", "wrench")}
        return replace(self, **columns)


def load_series(path: str | Path) -> WrenchSeries:
    """Read displacements, in mm from arrays or in px from tracks, with the wrench if there is one.

    Raises:
        RecordingError: The file cannot be read or holds neither.
    """
    require_type(path, PATH, "touch.load_series('contacts.npz')")
    values = load_arrays(path, "displacements, which spikingtac track RECORDING makes")
    unit = "mm" if "displacement_mm" in values else "px"
    try:
        t_us, reference = values["t_us"], values[f"reference_{unit}"]
        moved = values["displacement_mm"] if unit == "mm" else values["detected_px"] - reference
        wrench = values.get("wrench", np.empty((len(t_us), 0)))
        columns = t_us, reference, moved, wrench
        if any(column.dtype.kind not in "iuf" for column in columns):
            raise ValueError("an array holds no numbers")
        if (t_us != np.round(t_us)).any():
            raise ValueError("t_us holds fractions; it must be whole microseconds, not seconds")
        rest, away, labels = (one.astype(np.float64) for one in columns[1:])
        return WrenchSeries(t_us.astype(np.int64), rest, away, labels, unit, Path(path).name)
    except KeyError as error:
        raise RecordingError(
            f"{str(path)!r} holds no displacements; it must hold t_us, reference_mm and "
            "displacement_mm, or be the tracks of: spikingtac track RECORDING"
        ) from error
    except (TypeError, ValueError) as error:
        raise RecordingError(f"{str(path)!r}: {error}") from error


def labelled(series: WrenchSeries, path: str | Path) -> WrenchSeries:
    """Return a series with the forces of a file at its times; frames outside are left out.

    The file is ``truth.npz``, a simulation's folder, or the CSV of a force sensor. A CSV has
    another clock, whose offset is found from the motion. Its header names ``t_us`` or ``t_s``,
    ``fx``, ``fy``, ``fz`` (N) and all of ``mx``, ``my``, ``mz`` (Nm) or none.

    Raises:
        RecordingError: The file cannot be read, holds no wrench, is of another recording, or goes
            over more than a day.
    """
    source = Path(path)
    if source.suffix.lower() == ".csv":
        t_us, wrench = _from_csv(source)
        if len(series.t_us):
            t_us = t_us + _clock_offset_us(series, t_us, wrench)
    else:
        t_us, wrench = _from_truth(source / "truth.npz" if source.is_dir() else source)
    inside = (series.t_us >= t_us[0]) & (series.t_us <= t_us[-1]) if len(t_us) else np.zeros(0)
    if not inside.any():
        raise RecordingError(f"{series.name}: no frame lies within the time of its forces")
    columns = [np.interp(series.t_us, t_us, column) for column in wrench.T]
    return replace(series, wrench=np.column_stack(columns)).part(inside)


def _clock_offset_us(series: WrenchSeries, t_us: Times, wrench: FloatArray) -> int:
    """Return what must be added to the labels' times to get those of the displacements, us.

    The amount of motion and the amount of force are made uniform in time and correlated. Contacts
    that repeat alike at equal intervals are ambiguous: press once at an odd moment.
    """
    # A late import: every verb's start would wait for it.
    from scipy.signal import correlate

    def uniform(times_us: Times, values: FloatArray) -> FloatArray:
        if times_us[-1] - times_us[0] > US_PER_DAY:
            raise RecordingError(
                f"{series.name}: displacements or forces go from {times_us[0]} to {times_us[-1]} "
                "us, more than a day; is a time wrong? Cut them to the contacts"
            )
        even = np.interp(np.arange(times_us[0], times_us[-1] + 1, STEP_US), times_us, values)
        return even - even.mean()

    seen = uniform(series.t_us, np.sqrt((series.displacement**2).sum(axis=2).mean(axis=1)))
    felt = uniform(t_us, np.sqrt((wrench[:, :3] ** 2).sum(axis=1)))
    scale = float(np.sqrt((seen**2).sum() * (felt**2).sum()))
    score = correlate(seen, felt) / (scale if scale > 0.0 else 1.0)
    best = int(score.argmax())
    if not score[best] >= LEAST_CORRELATION:
        raise RecordingError(
            f"{series.name}: displacements and forces agree by {score[best]:.2f} at best; "
            "are they of the same recording?"
        )
    return int(series.t_us[0]) - int(t_us[0]) + (best - (len(felt) - 1)) * STEP_US


def _from_truth(path: Path) -> tuple[Times, FloatArray]:
    values = load_truth(path, ("contact_t_us", "force_n"))
    wrench = values["force_n"]
    if "torque_n_mm" in values:
        wrench = np.hstack([wrench, values["torque_n_mm"] / N_MM_PER_NM])
    return values["contact_t_us"], wrench


def _from_csv(path: Path) -> tuple[Times, FloatArray]:
    table = load_poses(path, "forces")
    names = [name.lower() for name in table.names]
    kept = [name for name in COMPONENTS if name in names]
    if kept not in (list(COMPONENTS), list(COMPONENTS[:3])):
        raise RecordingError(
            f"{str(path)!r} needs columns fx, fy, fz, and all of mx, my, mz or none; it has "
            f"{', '.join(table.names) or 'nothing'}"
        )
    return table.t_us, table.state[:, [names.index(name) for name in kept]]
