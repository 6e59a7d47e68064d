"""What a session showed, kept thinly: enough for a table and a picture at its end."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.viewer.session.layers import OFF_CODE, unpack
from spikingtac.viewer.session.wire import decode

MOST_ROWS = 4_096
"""Frames kept: 68 s at 60 per second; a longer session keeps every second, fourth... of its frames.

A row of 64 markers holds 512 bytes, so that a record stays at some 3 MiB however long it lasts.
"""


@dataclass(frozen=True, slots=True)
class _Row:
    t_s: float
    rate_kev_s: float
    moved_px: NDArray[np.float32]
    error_px: NDArray[np.float32] | None

    @classmethod
    def of(
        cls, meta: dict[str, Any], arrays: dict[str, NDArray[Any]], moved_px: NDArray[np.float32]
    ) -> _Row:
        error_px = None
        if "truth_px" in arrays:
            error_px = np.hypot(*(arrays["detected_px"] - arrays["truth_px"]).T)
        t_s = (meta["t_us"] - meta["t_start_us"]) / 1e6
        return cls(t_s, meta["events_per_s"] / 1e3, moved_px, error_px)


class Record:
    """Collects frames of a session as they are offered, those after a number."""

    def __init__(self, after: int = 0) -> None:
        self._number = after
        self._rows: list[_Row] = []
        self._taken, self._every = 0, 1
        self._played_us = 0
        self._largest_px = -1.0
        self._best: tuple[dict[str, Any], dict[str, NDArray[Any]]] | None = None
        self._last: dict[str, Any] = {}
        self._lost = 0

    def take(self, numbered: tuple[int, bytes] | None, reference_px: NDArray[np.floating]) -> None:
        """Take a frame message with its number, or None."""
        if numbered is None:
            return
        self._number, message = numbered
        meta, arrays = decode(message)
        self._played_us += max(meta["t_us"] - self._last.get("t_us", meta["t_start_us"]), 0)
        self._last = meta
        if len(arrays.get("position_px", ())) != len(reference_px) or not len(reference_px):
            return  # no marker is known, or not yet by whoever asks
        moved_px = np.hypot(*(arrays["position_px"] - reference_px).T).astype(np.float32)
        self._lost = max(self._lost, int(arrays["held"].sum()))
        if moved_px.max() > self._largest_px:
            self._largest_px, self._best = float(moved_px.max()), (meta, arrays)
        self._taken += 1
        if self._taken % self._every == 0:
            self._rows.append(_Row.of(meta, arrays, moved_px))
        if len(self._rows) > MOST_ROWS:
            self._rows, self._every = self._rows[1::2], 2 * self._every

    @property
    def number(self) -> int:
        """Number of the last frame taken."""
        return self._number

    def summary(self) -> dict[str, Any]:
        """Return the figures of the session so far."""
        last = self._last
        errors_px = np.array([row.error_px for row in self._rows if row.error_px is not None])
        document = {
            "played_s": round(self._played_us / 1e6, 3),
            "estimates": last.get("steps", 0),
            "step_p50_us": last.get("step_p50_us", 0.0),
            "step_p99_us": last.get("step_p99_us", 0.0),
            "contacts": last.get("contacts_found", 0),
            "displacement_max_px": last.get("displacement_max_px", 0.0),
            "held_at_once": self._lost,
            "losses": last.get("losses", {}),
            "health": last.get("health"),
        }
        if len(errors_px):
            document["error_mean_px"] = round(float(errors_px.mean(dtype=np.float64)), 4)
            document["error_p95_px"] = round(float(np.percentile(errors_px, 95)), 4)
        return document

    def save_picture(self, path: str | Path, hello: dict[str, Any]) -> bool:
        """Write the moment of largest displacement beside the course; False before a frame."""
        from spikingtac.plots.summary import Course, Picture, save_summary

        if self._best is None:
            return False
        meta, arrays = self._best
        step = hello["view_step"]
        codes = unpack(arrays["activity"], tuple(hello["view_size"]))
        start_us = meta["t_start_us"]
        rows = sorted(self._rows, key=lambda row: row.t_s)
        save_summary(
            path,
            f"{hello['label']}{' (simulated)' if hello['simulated'] else ''}",
            Picture(
                image=np.where(codes == 0, 0, np.where(codes < OFF_CODE, 1, 2)).astype(np.uint8),
                reference_px=np.array(hello["reference_px"]) / step,
                position_px=arrays["position_px"] / step,
                radius_px=np.array(hello["radius_px"]) / step,
                t_s=(meta["t_us"] - start_us) / 1e6,
            ),
            Course(
                t_s=np.array([row.t_s for row in rows]),
                displacement_px=np.array([row.moved_px for row in rows]),
                rate_kev_s=np.array([row.rate_kev_s for row in rows]),
                contacts_s=tuple((t_us - start_us) / 1e6 for t_us in self._last["contacts_us"]),
            ),
        )
        return True
