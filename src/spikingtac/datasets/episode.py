"""One recording as an episode: its tracks, and a robot's log, at the frames of a data set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events.formats.array_file import load_arrays
from spikingtac.tracks import Tracks

US_PER_S = 1_000_000

# Displacements, px: x and y of every marker, row by row.
DISPLACEMENT = "observation.tactile.displacement"
SEEN = "observation.tactile.seen"  # 1 where a marker was seen, 0 where its place is a prediction.

# Forces in N, then moments in Nm, where a force model told them.
WRENCH = "observation.tactile.wrench"
LOG_NAMES = {"state": "observation.state", "action": "action"}  # Array of a robot's log -> feature.


@dataclass(frozen=True, kw_only=True)
class Episode:
    """The features of an episode, one row for each frame.

    Attributes:
        name: Of the recording.
        t_us: ``(n,)`` times of the frames, us.
        features: Name -> ``(n, k)`` float32.
        names: Name -> names of its k columns.
        largest_age_us: How old the oldest value is that a frame was given, us.
    """

    name: str
    t_us: NDArray[np.int64]
    features: Mapping[str, NDArray[np.float32]]
    names: Mapping[str, tuple[str, ...]]
    largest_age_us: int

    @classmethod
    def of(cls, path: Path, fps: int, log: Path | None = None) -> Episode:
        """Read tracks, and a log on the same clock, and bring them to the same frames.

        A frame gets the last values before it, as a robot would have had them; nothing is
        interpolated from the future. Frames are where tracks and log overlap.

        Args:
            path: tracks.npz.
            fps: Frames per second.
            log: ``.npz`` with ``t_us (n,)`` and ``state (n, k)``, ``action (n, k)`` or both.

        Raises:
            RecordingError: A file cannot be read, or holds nothing.
            ConfigError: Tracks and log do not overlap.
        """
        tracks = Tracks.load(path)
        if not len(tracks.t_us):
            raise RecordingError(f"{str(path)!r} holds no estimate")
        sources = {DISPLACEMENT: (tracks.t_us, _flat(tracks.displacement_px))}
        sources[SEEN] = (tracks.t_us, (~tracks.coasted).astype(np.float32))
        if tracks.wrench is not None:
            sources[WRENCH] = (tracks.t_us, tracks.wrench)
        if log is not None:
            sources |= _log(log)
        t_us = _frames(path, [t for t, _ in sources.values()], fps)
        rows = {name: np.searchsorted(t, t_us, "right") - 1 for name, (t, _) in sources.items()}
        features = {
            name: np.ascontiguousarray(values[rows[name]], np.float32)
            for name, (_, values) in sources.items()
        }
        ages = (t_us - t[rows[name]] for name, (t, _) in sources.items())
        return cls(
            name=path.stem,
            t_us=t_us,
            features=features,
            names={name: _names(name, values.shape[1]) for name, values in features.items()},
            largest_age_us=int(max(age.max() for age in ages)),
        )


def _frames(path: Path, times: list[NDArray[np.int64]], fps: int) -> NDArray[np.int64]:
    first_us, last_us = max(t[0] for t in times), min(t[-1] for t in times)
    if last_us < first_us:
        raise ConfigError(
            f"{str(path)!r} and its log do not overlap: one ends at {last_us} us, the other begins "
            f"at {first_us} us; both must be on the same clock"
        )
    count = int((last_us - first_us) * fps // US_PER_S) + 1
    return first_us + np.arange(count, dtype=np.int64) * US_PER_S // fps


def _log(path: Path) -> dict[str, tuple[NDArray[np.int64], NDArray[np.float32]]]:
    arrays = load_arrays(path, "a robot's log")
    found = {feature: arrays[name] for name, feature in LOG_NAMES.items() if name in arrays}
    t_us = arrays.get("t_us")
    fits = t_us is not None and t_us.ndim == 1 and t_us.dtype.kind in "iu" and len(t_us) > 0
    if t_us is None or not fits or not found or (np.diff(t_us.astype(np.int64)) < 0).any():
        raise RecordingError(
            f"{str(path)!r} is no log of a robot: it needs t_us (whole us, in order) and state, "
            "action or both"
        )
    for feature, values in found.items():
        if values.ndim != 2 or len(values) != len(t_us) or values.dtype.kind not in "fiu":
            raise RecordingError(
                f"{str(path)!r}: {feature} has shape {values.shape}, it must be ({len(t_us)}, k)"
            )
    t = t_us.astype(np.int64)
    return {feature: (t, values.astype(np.float32)) for feature, values in found.items()}


def _flat(values: NDArray[np.float32]) -> NDArray[np.float32]:
    return values.reshape(len(values), -1)


def _names(feature: str, count: int) -> tuple[str, ...]:
    if feature == DISPLACEMENT:
        return tuple(f"{axis}_{marker}" for marker in range(count // 2) for axis in "xy")
    if feature == SEEN:
        return tuple(f"marker_{marker}" for marker in range(count))
    if feature == WRENCH:
        return ("fx", "fy", "fz", "tx", "ty", "tz")[:count]
    short = feature.rpartition(".")[2]
    return tuple(f"{short}_{number}" for number in range(count))
