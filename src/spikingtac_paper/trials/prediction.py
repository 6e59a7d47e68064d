"""The estimates of a method on a trial, as they are stored between tracking and scoring."""

from __future__ import annotations

from collections.abc import Callable, Iterable
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
        reference_px: ``(m, 2)`` the rest positions of the calibration, px.
    """

    t_us: NDArray[np.int64]
    detected_px: NDArray[np.float32]
    position_px: NDArray[np.float32]
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
            reference_px=reference_px,
        )

    def _save(self, path: Path, key: str) -> None:
        same = np.array_equal(self.detected_px, self.position_px)
        with replacing(path) as temporary:
            np.savez(
                temporary,
                key=np.array(key),
                t_us=self.t_us,
                detected_px=self.detected_px,
                position_px=np.empty(0, np.float32) if same else self.position_px,
                reference_px=self.reference_px,
            )

    @classmethod
    def kept(cls, path: Path, key: str, make: Callable[[], Self]) -> Self:
        """Return the prediction of a file if it has this key; else make it, and write it."""
        try:
            with np.load(path, allow_pickle=False) as archive:
                values = {name: archive[name] for name in archive.files}
        except (OSError, ValueError, EOFError, KeyError):
            values = {}
        if str(values.get("key")) != key:
            made = make()
            made._save(path, key)
            return made
        detected_px, position_px = values["detected_px"], values["position_px"]
        given_px = position_px if position_px.size else detected_px
        return cls(values["t_us"], detected_px, given_px, values["reference_px"])


def _stacked(arrays: list[NDArray[np.float64]], markers: int) -> NDArray[np.float32]:
    return np.array(arrays, np.float32).reshape(-1, markers, 2)
