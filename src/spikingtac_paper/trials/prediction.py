"""The estimates of a method on a trial, as they are stored between tracking and scoring."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import replacing
from spikingtac.types import MarkerFrame


@dataclass(frozen=True, slots=True)
class Prediction:
    """Estimates of one method on one recording.

    Attributes:
        t_us: ``(n,)`` int64 times, us.
        detected_px: ``(n, m, 2)`` float32, the truthful estimate, px.
        position_px: ``(n, m, 2)`` float32, after the method's own law, px.
        coasted: ``(n, m)`` True where a position is predicted without an observation.
        reference_px: ``(m, 2)`` the rest positions of the calibration, px.
    """

    t_us: NDArray[np.int64]
    detected_px: NDArray[np.float32]
    position_px: NDArray[np.float32]
    coasted: NDArray[np.bool_]
    reference_px: NDArray[np.float64]

    @classmethod
    def collect(
        cls, frames: Iterable[MarkerFrame], reference_px: NDArray[np.float64], every: int
    ) -> Self:
        """Keep every ``every``-th frame of a tracked stream, and the last one.

        Args:
            frames: The estimates in order of time.
            reference_px: ``(m, 2)`` rest positions, px.
            every: Distance of the frames that are kept; 1 keeps all.
        """
        kept: list[MarkerFrame] = []
        last: MarkerFrame | None = None
        for number, frame in enumerate(frames):
            last = frame
            if number % every == 0:
                kept.append(frame)
        if last is not None and kept[-1] is not last:
            kept.append(last)
        count = len(reference_px)
        return cls(
            t_us=np.array([frame.t_us for frame in kept], np.int64),
            detected_px=_stacked([frame.detected_px for frame in kept], count),
            position_px=_stacked([frame.position_px for frame in kept], count),
            coasted=np.array([frame.coasted for frame in kept], np.bool_).reshape(-1, count),
            reference_px=reference_px,
        )

    def save(self, path: Path, key: str) -> None:
        """Write the arrays, whole or not at all.

        Args:
            path: ``.npz`` file.
            key: Digest of everything that the prediction depends on.
        """
        same = np.array_equal(self.detected_px, self.position_px)
        with replacing(path) as temporary:
            np.savez(
                temporary,
                key=np.array(key),
                t_us=self.t_us,
                detected_px=self.detected_px,
                position_px=np.empty(0, np.float32) if same else self.position_px,
                coasted=np.packbits(self.coasted),
                reference_px=self.reference_px,
            )

    @classmethod
    def load(cls, path: Path, key: str | None = None) -> Self | None:
        """Read a prediction; return None where there is none with this key."""
        try:
            with np.load(path, allow_pickle=False) as archive:
                if key is not None and str(archive["key"]) != key:
                    return None
                values = {name: archive[name] for name in archive.files}
        except (OSError, ValueError, EOFError, KeyError):
            return None
        detected_px = values["detected_px"]
        shape = detected_px.shape[:2]
        coasted = np.unpackbits(values["coasted"], count=shape[0] * shape[1]).astype(np.bool_)
        position_px = values["position_px"] if values["position_px"].size else detected_px
        return cls(
            values["t_us"], detected_px, position_px, coasted.reshape(shape), values["reference_px"]
        )


def _stacked(arrays: list[NDArray[np.float64]], markers: int) -> NDArray[np.float32]:
    return np.array(arrays, np.float32).reshape(-1, markers, 2)
