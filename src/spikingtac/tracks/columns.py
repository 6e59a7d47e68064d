"""The columns of tracks: one row for each time in archives, one for each marker too in tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.formats.codec import TRIGGERS
from spikingtac.types import MarkerFrame

Columns = Mapping[str, NDArray[Any]]  # Key of a file -> values.

VECTORS = ("detected_px", "position_px", "displacement_px")  # Those that have an x and a y.
PER_MARKER = (*VECTORS, "held", "confidence")

# Counters of the source at each time; older files lack them.
HEALTH = ("gaps", "overflows", "damaged", "reconnects", "rate_ev_s")

# Force on the skin, its standard deviation, moment: where a model estimated them.
FORCES = ("force_n", "force_sigma_n", "torque_nm")

# Key of the places' standard deviation: where tracks were smoothed.
SIGMA = "sigma_px"

# Key of a file -> type of its numbers, and shape: n times, m markers, k trigger edges.
SPECS: dict[str, tuple[type[np.generic], str]] = {
    "t_us": (np.int64, "n"),
    "reference_px": (np.float32, "m2"),
    **dict.fromkeys(VECTORS, (np.float32, "nm2")),
    "held": (np.bool_, "nm"),
    "confidence": (np.float32, "nm"),
    **dict.fromkeys(HEALTH[:4], (np.int32, "n")),
    "rate_ev_s": (np.float32, "n"),
    **dict.fromkeys(FORCES, (np.float32, "n3")),
    SIGMA: (np.float32, "nm2"),
    **dict(zip(TRIGGERS, ((np.int64, "k"), (np.uint8, "k"), (np.bool_, "k")), strict=True)),
}

ATTRIBUTES = {"held": "coasted"}  # Key of a file -> the attribute that holds it, where they differ.


def require_shapes(values: Columns) -> None:
    """Refuse arrays that do not belong together.

    Raises:
        ValueError: A shape or a type does not fit.
        KeyError: An array is missing.
    """
    edges = values.get(TRIGGERS[0], ())
    sizes = {"n": len(values["t_us"]), "m": len(values["reference_px"]), "k": len(edges)}
    for name, (dtype, letters) in SPECS.items():
        if name not in values and name not in ("t_us", "reference_px", *PER_MARKER):
            continue
        array = values[name]
        shape = tuple(sizes[one] if one in sizes else int(one) for one in letters)
        if array.shape != shape or array.dtype.kind != np.dtype(dtype).kind:
            raise ValueError(
                f"{name} is {array.dtype} of shape {array.shape}, it must be "
                f"{np.dtype(dtype)} of shape {shape}"
            )


def stacked(frames: Sequence[MarkerFrame], markers: int) -> dict[str, NDArray[Any]]:
    """Return the values of frames by their keys in a file: ``t_us (n,)``, then ``(n, m, ...)``.

    Args:
        frames: Any number, also none.
        markers: How many markers each has.
    """
    sizes, columns = {"n": len(frames), "m": markers, "2": 2}, {}
    for name in ("t_us", *PER_MARKER, *HEALTH):
        dtype, letters = SPECS[name]
        attribute = ATTRIBUTES.get(name, name)
        rows = [getattr(one.health if name in HEALTH else one, attribute) for one in frames]
        columns[name] = np.array(rows, dtype).reshape([sizes[one] for one in letters])
    return columns


def long_columns(columns: Columns) -> dict[str, NDArray[Any]]:
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


def _by_axis(name: str, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Return the columns of ``(n, 2 or 3)`` values, with the axis before the unit."""
    quantity, _, unit = name.rpartition("_")
    return {f"{quantity}_{axis}_{unit}": of for axis, of in zip("xyz", values.T, strict=False)}


def trigger_column(
    t_us: NDArray[np.int64], triggers: Columns, since_us: int | None = None
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
