"""Pieces put together: one file of tracks, as if the recording had been tracked at once."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.formats.array_file import load_arrays
from spikingtac.markers.hysteresis import OutputLaw
from spikingtac.pipeline.recording_tracks import force_estimator, wrench_columns
from spikingtac.touch.force.model import ForceEstimator, ForceModel
from spikingtac.tracks import create_tracks
from spikingtac.tracks.columns import COLUMN_TYPES, FIELDS, HEALTH_TYPES
from spikingtac.tracks.files import NpzTracksWriter
from spikingtac.types import MarkerFrame

COUNTERS = tuple(name for name in HEALTH_TYPES if name != "rate_ev_s")
"""What counts from the beginning of a recording."""

NARROW = ("t_us", *HEALTH_TYPES)
"""Columns that have one number a time."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Stretch:
    """A part of a file of tracks.

    Attributes:
        path: The file.
        from_us: First time that counts, us.
        to_us: First time after it, us; None is the end.
    """

    path: Path
    from_us: int
    to_us: int | None

    def load(self, names: Collection[str]) -> dict[str, NDArray[Any]]:
        """Return columns of the part by their names in a file, the times first.

        Raises:
            RecordingError: The file is damaged, or a column is not there.
        """
        columns = load_arrays(self.path, "tracks", {"t_us": None} | dict.fromkeys(names))
        first = int(columns["t_us"].searchsorted(self.from_us))
        last = None if self.to_us is None else int(columns["t_us"].searchsorted(self.to_us))
        return {name: column[first:last] for name, column in columns.items()}


@dataclass(slots=True)
class JoinSummary:
    """What was joined.

    Attributes:
        estimates: Number of times.
        coasted: ``(m,)`` how often each marker was coasted.
        largest_px: Largest displacement, px.
    """

    estimates: int
    coasted: NDArray[np.int64]
    largest_px: float

    def add(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Count what some columns tell of some times."""
        for name, values in columns.items():
            if name == "t_us":
                self.estimates += len(values)
            elif name == "held":
                self.coasted += values.sum(axis=0)
            elif name == "displacement_px":
                moved_px = np.hypot(values[:, :, 0], values[:, :, 1])
                self.largest_px = max(self.largest_px, float(moved_px.max(initial=0.0)))


def join(
    stretches: Sequence[Stretch],
    output: Path,
    calibration: Calibration,
    law: OutputLaw | None,
    meta: Mapping[str, Any],
    force: ForceModel | None = None,
) -> JoinSummary:
    """Write stretches one after the other; one of them is in memory at a time.

    What goes into an archive as it is goes there column by column, without a copy in between. A law
    or a force whose value depends on the path is applied here, where the path is whole.

    Args:
        stretches: Without gap or overlap, in order of time.
        output: ``.npz``, ``.csv`` or ``.parquet``.
        calibration: The sensor's calibration.
        law: Law of the output position; None where it is the detected one.
        meta: What the file tells about itself.
        force: Tells the wrench of every frame, too (``.npz`` only).

    Raises:
        ConfigError: The force model is of another sensor, or the output is no ``.npz``.
    """
    estimator = force_estimator(force, output, len(calibration.reference_px))
    writer = create_tracks(output, calibration.reference_px)
    summary = JoinSummary(0, np.zeros(len(calibration.reference_px), np.int64), 0.0)
    archive = writer if isinstance(writer, NpzTracksWriter) else None
    lent = COLUMN_TYPES if archive is not None and law is None else {}
    names = {*NARROW, *(COLUMN_TYPES.keys() - lent.keys())}
    if estimator is not None:
        names.add("detected_px")
    try:
        for columns in _continued(stretches, names):
            if law is not None:
                _apply(law, columns, calibration.reference_px)
            if estimator is not None:
                columns |= _wrenches(estimator, columns, calibration.reference_px)
            columns = {name: values for name, values in columns.items() if name not in lent}
            summary.add(columns)
            if archive is not None:
                archive.write_columns(columns)
            else:
                for frame in _frames(columns):
                    writer.write(frame)
        if archive is not None:
            for name in lent:
                archive.lend_column(name, summary.estimates, _rows(stretches, name, summary))
        writer.close(meta)
    except BaseException:
        writer.abandon()
        raise
    return summary


def _rows(stretches: Sequence[Stretch], name: str, summary: JoinSummary) -> Iterator[NDArray[Any]]:
    """Yield a column that goes into the file as it is, and count it."""
    for stretch in stretches:
        rows = stretch.load([name])[name]
        summary.add({name: rows})
        yield rows


def _continued(
    stretches: Sequence[Stretch], names: Collection[str]
) -> Iterator[dict[str, NDArray[Any]]]:
    """Yield columns, with counters that go on where each piece began to count anew."""
    reached = dict.fromkeys(COUNTERS, 0)
    for stretch in stretches:
        columns = stretch.load(names)
        if len(columns["t_us"]):
            for name in COUNTERS:
                columns[name] = columns[name] - columns[name][0] + reached[name]
                reached[name] = int(columns[name][-1])
            yield columns


def _apply(law: OutputLaw, columns: dict[str, NDArray[Any]], reference_px: Any) -> None:
    position_px = columns["position_px"].copy()
    for row, detected_px in enumerate(columns["detected_px"].astype(np.float64)):
        position_px[row] = law.update(detected_px, reference_px)
    columns["position_px"] = position_px
    columns["displacement_px"] = (position_px - reference_px).astype(np.float32)


def _wrenches(
    estimator: ForceEstimator, columns: Mapping[str, NDArray[Any]], reference_px: Any
) -> dict[str, NDArray[np.float32]]:
    moved_px = columns["detected_px"].astype(np.float64) - reference_px
    times_us = columns["t_us"].tolist()
    rows = [
        wrench_columns(estimator.update(t_us, moved))
        for t_us, moved in zip(times_us, moved_px, strict=True)
    ]
    return {name: np.array([row[name] for row in rows], np.float32) for name in rows[0]}


def _frames(columns: Mapping[str, NDArray[Any]]) -> Iterator[MarkerFrame]:
    values = {FIELDS.get(name, name): columns[name] for name in ("t_us", *COLUMN_TYPES)}
    for row, t_us in enumerate(columns["t_us"].tolist()):
        frame = MarkerFrame(**{name: column[row] for name, column in values.items()})
        yield replace(frame, t_us=t_us)
