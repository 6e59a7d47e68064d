"""The displacement of every marker over time: tracks of a recording, in memory."""

from __future__ import annotations

import importlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.lens import SkinScale
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import PATH, ConfigError, RecordingError, import_extra, require_type
from spikingtac.events.formats.array_file import load_arrays, require_shapes
from spikingtac.events.formats.codec import TRIGGERS
from spikingtac.file_kinds import kind_of, told_kind
from spikingtac.tracks.files import (
    ATTRIBUTES,
    FORCES,
    HEALTH,
    NEEDED,
    SIGMA,
    SPECS,
    VECTORS,
    create_tracks,
    long_columns,
    stacked,
    trigger_column,
)
from spikingtac.types import US_PER_S, FloatArray, MarkerFrame, SourceHealth

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


def longest(vectors: NDArray[np.floating]) -> float:
    """Return the length of the longest vector."""
    return float(np.linalg.norm(vectors, axis=-1).max(initial=0.0))


# Module that draws tracks, found by its name: plots stand on tracks, and tracks on no plots.
DRAWING = "spikingtac.plots.tracks"


@dataclass(frozen=True, repr=False)
class Tracks:
    """Marker tracks of one recording.

    Attributes:
        t_us: ``(n,)`` int64 times, us.
        detected_px: ``(n, m, 2)`` the truthful estimate, px.
        position_px: ``(n, m, 2)`` after the hysteresis law, px.
        displacement_px: ``(n, m, 2)`` position minus reference, px.
        coasted: ``(n, m)`` True where a position was sustained or predicted.
        confidence: ``(n, m)`` 0 to 1.
        reference_px: ``(m, 2)`` rest positions, px.
        meta: Resolved configuration, input digest, package version, loss counters; where they are
            known also ``px_per_mm`` and ``grid``.
        sigma_px: ``(n, m, 2)`` standard deviation of ``detected_px`` along x and y; None unless the
            tracks were smoothed.
        force_n: ``(n, 3)`` estimated force on the skin, N; None where no force model was given.
        force_sigma_n: ``(n, 3)`` its standard deviation.
        torque_nm: ``(n, 3)`` estimated moment, Nm, where the force model knows it.
        gaps, overflows, damaged, reconnects, rate_ev_s: ``(n,)`` the health of the events as in
            :class:`~spikingtac.types.SourceHealth`; None in files of older versions.
        trigger_t_us, trigger_channel, trigger_edge: ``(k,)`` trigger edges; None without any.
    """

    t_us: NDArray[np.int64]
    detected_px: NDArray[np.float32]
    position_px: NDArray[np.float32]
    displacement_px: NDArray[np.float32]
    coasted: NDArray[np.bool_]
    confidence: NDArray[np.float32]
    reference_px: NDArray[np.float32]
    meta: dict[str, Any]
    sigma_px: NDArray[np.float32] | None = None
    force_n: NDArray[np.float32] | None = None
    force_sigma_n: NDArray[np.float32] | None = None
    torque_nm: NDArray[np.float32] | None = None
    gaps: NDArray[np.int32] | None = None
    overflows: NDArray[np.int32] | None = None
    damaged: NDArray[np.int32] | None = None
    reconnects: NDArray[np.int32] | None = None
    rate_ev_s: NDArray[np.float32] | None = None
    trigger_t_us: NDArray[np.int64] | None = None
    trigger_channel: NDArray[np.uint8] | None = None
    trigger_edge: NDArray[np.bool_] | None = None

    def __repr__(self) -> str:
        """Return one line for people."""
        found = self.summary()
        return (
            f"<Tracks: {found['markers']} markers, {found['estimates']} estimates in "
            f"{found['duration_s']:.3f} s, largest displacement "
            f"{found['displacement_max_px']:.2f} px, {found['held_share']:.1%} coasted>"
        )

    @classmethod
    def of(cls, frames: Iterable[MarkerFrame], calibration: Calibration) -> Self:
        """Gather frames, as :func:`spikingtac.follow` yields them.

        Args:
            frames: Any number of frames, in order of time.
            calibration: That they were tracked with.
        """
        values: dict[str, Any] = stacked(list(frames), len(calibration.reference_px))
        values["reference_px"] = calibration.reference_px.astype(np.float32)
        return cls._by_key(values, calibration.scale())

    @classmethod
    def _by_key(cls, values: dict[str, Any], meta: dict[str, Any]) -> Self:
        return cls(meta=meta, **{ATTRIBUTES.get(name, name): v for name, v in values.items()})

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read ``tracks.npz``.

        Raises:
            RecordingError: The file cannot be read or holds no tracks.
            ConfigError: No path was given.
        """
        require_type(path, PATH, "Tracks.load('tracks.npz')")
        try:
            values: dict[str, Any] = load_arrays(path, "tracks")
            meta = json.loads(str(values.pop("meta")))
            if not isinstance(meta, dict):
                raise ValueError("meta is no JSON object")
            require_shapes(values, SPECS, NEEDED)
            return cls._by_key(values, meta)
        except (RecordingError, ValueError, KeyError, TypeError, RecursionError) as error:
            other = kind_of(path) not in (None, "tracks") and told_kind(path)
            reason = other or str(error).rpartition("cannot be read as tracks: ")[2]
            raise RecordingError(
                f"{str(path)!r} holds no tracks: {reason}; "
                "make them with: spikingtac track RECORDING --calibration calibration.json"
            ) from error

    def save(self, path: str | Path) -> None:
        """Write ``.npz``, ``.csv`` or ``.parquet``.

        Raises:
            ConfigError: The ending is another, or the folder does not exist.
            MissingExtraError: ``.parquet`` needs the extra ``[parquet]``.
        """
        felt = self._known((SIGMA, *FORCES))
        with create_tracks(path, self.reference_px.astype(np.float64)) as writer:
            writer.meta = self.meta
            writer.triggers = self._known(TRIGGERS)
            for number, frame in enumerate(self.frames()):
                writer.write(frame, {name: values[number] for name, values in felt.items()})

    def frames(self) -> Iterator[MarkerFrame]:
        """Yield the estimates one by one."""
        for number, t_us in enumerate(self.t_us.tolist()):
            values = {name: getattr(self, name)[number] for name in (*VECTORS, "coasted")}
            health, confidence = self._health(number), self.confidence[number]
            yield MarkerFrame(t_us=t_us, health=health, confidence=confidence, **values)

    def _health(self, number: int) -> SourceHealth:
        return SourceHealth(**{name: v[number].item() for name, v in self._known(HEALTH).items()})

    @property
    def px_per_mm(self) -> float | None:
        """The scale, or None where the calibration knew no pitch."""
        scale = self.meta.get("px_per_mm")
        return float(scale) if isinstance(scale, int | float) and scale > 0 else None

    @property
    def skin_scale(self) -> SkinScale | None:
        """From pixels to the skin, or None where the calibration knew no pitch."""
        try:
            return SkinScale.of(self.px_per_mm, self.meta.get("lens"))
        except (KeyError, TypeError, ValueError) as error:
            raise RecordingError(f"the lens of these tracks is damaged: {error}") from error

    @property
    def displacement_mm(self) -> FloatArray:
        """``(n, m, 2)`` displacement on the skin, mm.

        Raises:
            ConfigError: The scale is not known.
        """
        scale = self.skin_scale
        if scale is None:
            raise ConfigError(
                "these tracks know no scale; calibrate with --pitch-mm, the distance of "
                "neighbouring markers on the skin, and track again"
            )
        rest_px = self.reference_px.astype(np.float64)
        return scale.to_mm(rest_px + self.displacement_px) - scale.to_mm(rest_px)

    def summary(self) -> dict[str, Any]:
        """Return the figures of the tracks.

        Returns:
            ``markers``, ``estimates``, ``t_first_us``, ``t_last_us``, ``duration_s``, ``rate_hz``
            (the median), ``displacement_max_px`` with its ``displacement_max_marker`` and
            ``displacement_max_t_us``, ``displacement_max_mm``, ``held_share``, ``never_observed``
            (markers that were coasted throughout), ``health`` (the counters at the end, and the
            mean rate), ``px_per_mm`` and ``force_max_n``; None where unknown.
        """
        estimates, markers = self.coasted.shape
        moved_px = np.hypot(*np.moveaxis(self.displacement_px, 2, 0))
        empty = moved_px.size == 0
        at, marker = (0, 0) if empty else np.unravel_index(moved_px.argmax(), moved_px.shape)
        steps_us = np.diff(self.t_us)
        scaled = self.px_per_mm is not None
        health = None
        if self.rate_ev_s is not None and estimates:
            rate_ev_s = float(self.rate_ev_s.mean(dtype=np.float64))
            health = replace(self._health(estimates - 1), rate_ev_s=rate_ev_s).summary()
        never = np.flatnonzero(self.coasted.all(axis=0)) if estimates else np.zeros(0, int)
        return {
            "markers": markers,
            "estimates": estimates,
            "t_first_us": int(self.t_us[0]) if estimates else None,
            "t_last_us": int(self.t_us[-1]) if estimates else None,
            "duration_s": float(steps_us.sum() / US_PER_S),
            "rate_hz": float(US_PER_S / np.median(steps_us)) if len(steps_us) else None,
            "displacement_max_px": 0.0 if empty else float(moved_px[at, marker]),
            "displacement_max_marker": None if empty else int(marker),
            "displacement_max_t_us": None if empty else int(self.t_us[at]),
            "displacement_max_mm": longest(self.displacement_mm) if scaled else None,
            "held_share": 0.0 if empty else float(self.coasted.mean()),
            "never_observed": never.tolist(),
            "health": health,
            "px_per_mm": self.px_per_mm,
            "force_max_n": None if self.force_n is None else longest(self.force_n),
        }

    def to_pandas(self) -> DataFrame:
        """Return the tracks as a table in long form: one row for each time and marker.

        Its columns are those of the CSV file, with ``displacement_x_mm`` and ``displacement_y_mm``
        where the scale is known, ``force_x_n`` where the force is, ``trigger`` where any came.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        pandas = import_extra("pandas", "a table", "tables")
        columns = self._known(("t_us", *VECTORS, SIGMA))
        if self.px_per_mm is not None:
            columns["displacement_mm"] = self.displacement_mm
        each = {"held": self.coasted, "confidence": self.confidence}
        columns |= each | self._known(FORCES) | trigger_column(self.t_us, self._known(TRIGGERS))
        return pandas.DataFrame(long_columns(columns))

    def plot(
        self,
        kind: str = "course",
        *,
        at_us: int | None = None,
        theme: str = "light",
        width: str = "single",
    ) -> Figure:
        """Draw the tracks; see :func:`spikingtac.plot_tracks`, which takes the same options."""
        draw = importlib.import_module(DRAWING).plot_tracks
        return draw(self, kind, at_us=at_us, theme=theme, width=width)

    @property
    def wrench(self) -> NDArray[np.float32] | None:
        """``(n, 3 or 6)`` forces in N, then moments in Nm where they are known; None without."""
        parts = [part for part in (self.force_n, self.torque_nm) if part is not None]
        return np.hstack(parts) if parts else None

    def _known(self, names: Iterable[str]) -> dict[str, NDArray[Any]]:
        return {name: v for name in names if (v := getattr(self, name)) is not None}
