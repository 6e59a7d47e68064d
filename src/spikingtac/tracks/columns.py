"""The columns of tracks: one row for each time in archives, one for each marker too in tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.formats.codec import TRIGGERS
from spikingtac.types import MarkerFrame

# Columns in long form, in their order: what CSV, Parquet and tables hold.
CSV_COLUMNS = (
    "t_us",
    "marker",
    "detected_x_px",
    "detected_y_px",
    "position_x_px",
    "position_y_px",
    "displacement_x_px",
    "displacement_y_px",
    "held",
    "confidence",
)

FIELDS = {"held": "coasted"}  # Key of a file -> the attribute that holds it, where the two differ.

# Key of a file -> the type of its numbers.
COLUMN_TYPES = {
    "detected_px": np.float32,
    "position_px": np.float32,
    "displacement_px": np.float32,
    "held": np.bool_,
    "confidence": np.float32,
}

# Key of a file -> the type of a counter of the source, one a time; older files lack them.
HEALTH_TYPES = {
    "gaps": np.int32,
    "overflows": np.int32,
    "damaged": np.int32,
    "reconnects": np.int32,
    "rate_ev_s": np.float32,
}

# Force on the skin and its standard deviation, ``(n, 3)``: where a model estimated them.
FORCES = ("force_n", "force_sigma_n", "torque_nm")

# Key of the places' standard deviation, ``(n, m, 2)``: where tracks were smoothed.
SIGMA = "sigma_px"

VECTORS = ("detected_px", "position_px", "displacement_px")  # Those that have an x and a y.


def by_attribute(values: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Return columns by the attributes of tracks instead of their keys in a file."""
    return {FIELDS.get(name, name): array for name, array in values.items()}


def stacked(frames: Sequence[MarkerFrame], markers: int) -> dict[str, NDArray[Any]]:
    """Return the values of frames by their keys in a file: ``t_us (n,)``, then ``(n, m, ...)``.

    Args:
        frames: Any number, also none.
        markers: How many markers each has.
    """
    columns: dict[str, NDArray[Any]] = {
        "t_us": np.array([frame.t_us for frame in frames], np.int64)
    }
    for name, dtype in COLUMN_TYPES.items():
        rows = [getattr(frame, FIELDS.get(name, name)) for frame in frames]
        shape = (len(frames), markers, 2) if name in VECTORS else (len(frames), markers)
        columns[name] = np.array(rows, dtype).reshape(shape)
    for name, dtype in HEALTH_TYPES.items():
        columns[name] = np.array([getattr(frame.health, name) for frame in frames], dtype)
    return columns


def long_columns(columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return columns in long form, one row for each time and marker, by name.

    Args:
        columns: ``t_us``, ``held``, ``confidence`` and any vectors ``(n, m, 2)`` by their keys in a
            file: ``displacement_px`` becomes ``displacement_x_px`` and ``displacement_y_px``.
            Forces ``(n, 3)`` are repeated for every marker.
    """
    estimates, markers = columns["held"].shape
    rows: dict[str, NDArray[Any]] = {
        "t_us": np.repeat(columns["t_us"], markers),
        "marker": np.tile(np.arange(markers), estimates),
    }
    for name, vector in columns.items():
        if vector.ndim == 3:
            rows |= _by_axis(name, vector.reshape(estimates * markers, 2))
    rows |= {name: columns[name].ravel() for name in ("held", "confidence")}
    for name in FORCES:
        if name in columns:
            rows |= _by_axis(name, np.repeat(columns[name], markers, axis=0))
    if "trigger" in columns:
        rows["trigger"] = np.repeat(columns["trigger"], markers)
    return rows


def trigger_column(
    t_us: NDArray[np.int64], triggers: Mapping[str, NDArray[Any]], since_us: int | None = None
) -> dict[str, NDArray[Any]]:
    """Return the column ``trigger``: the channel of the last edge since the estimate before.

    Args:
        t_us: ``(n,)`` times of the estimates, us.
        triggers: Edges by their keys in a file, in order of time; none give no column.
        since_us: Time of the estimate before the first one; None where there is none.
    """
    edges_us, channel, _ = (triggers.get(name, np.zeros(0)) for name in TRIGGERS)
    if not len(edges_us):
        return {}
    before = 0 if since_us is None else np.searchsorted(edges_us, since_us, side="right")
    passed = np.searchsorted(edges_us, t_us, side="right")
    none = np.diff(passed, prepend=before) == 0
    return {"trigger": np.ma.MaskedArray(channel.astype(np.int16)[passed - 1], mask=none)}


def longest(vectors: NDArray[np.floating]) -> float:
    """Return the length of the longest vector."""
    return float(np.linalg.norm(vectors, axis=-1).max(initial=0.0))


def _by_axis(name: str, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Return the columns of ``(n, 2 or 3)`` values, with the axis before the unit."""
    quantity, _, unit = name.rpartition("_")
    axes = "xyz"[: values.shape[1]]
    return {f"{quantity}_{axis}_{unit}": values[:, n] for n, axis in enumerate(axes)}


def require_shapes(values: Mapping[str, NDArray[Any]]) -> None:
    """Refuse arrays that do not belong together.

    Raises:
        ValueError: A shape or a type does not fit; KeyError where an array is missing.
    """
    times, markers = values["t_us"].shape, len(values["reference_px"])
    if len(times) != 1 or values["t_us"].dtype.kind != "i":
        raise ValueError("t_us must be one row of whole numbers")
    if values["reference_px"].shape != (markers, 2):
        raise ValueError(f"reference_px has shape {values['reference_px'].shape}")
    for name, dtype in COLUMN_TYPES.items():
        array = values[name]
        shape = (*times, markers, 2) if name in VECTORS else (*times, markers)
        if array.shape != shape or array.dtype.kind != np.dtype(dtype).kind:
            raise ValueError(f"{name} is {array.dtype} of shape {array.shape}, not of {shape}")
    for name in FORCES:
        if name in values and values[name].shape != (*times, 3):
            raise ValueError(f"{name} has shape {values[name].shape}, not {(*times, 3)}")
    if SIGMA in values and values[SIGMA].shape != (*times, markers, 2):
        raise ValueError(f"{SIGMA} has shape {values[SIGMA].shape}, not {(*times, markers, 2)}")
    edges = [values[name] for name in TRIGGERS if name in values]
    shapes, kinds = {edge.shape for edge in edges}, "".join(edge.dtype.kind for edge in edges)
    if edges and (kinds != "iub" or shapes != {(edges[0].size,)}):
        raise ValueError(f"{', '.join(TRIGGERS)} must be rows of one length")
    for name in HEALTH_TYPES:
        if name in values and values[name].shape != times:
            raise ValueError(f"{name} has shape {values[name].shape}, not {times}")
