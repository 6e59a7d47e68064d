"""What a session showed, kept thinly: enough for a table and a picture at its end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.viewer.layers import OFF_CODE, unpack
from spikingtac.viewer.wire import decode

MOST_ROWS = 20_000
"""Frames kept: five minutes at 60 per second; a longer session keeps its beginning."""


class Record:
    """Collects frames of a session as they are offered."""

    def __init__(self) -> None:
        self._number = 0
        self._rows: list[tuple[float, float, NDArray[np.float64]]] = []
        self._errors_px: list[NDArray[np.floating]] = []
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
        self._last = meta
        if "position_px" not in arrays or len(self._rows) >= MOST_ROWS:
            return
        moved_px = np.hypot(*(arrays["position_px"] - reference_px).T).astype(np.float64)
        t_s = (meta["t_us"] - meta["t_start_us"]) / 1e6
        self._rows.append((t_s, meta["events_per_s"] / 1e3, moved_px))
        if "truth_px" in arrays:
            self._errors_px.append(np.hypot(*(arrays["detected_px"] - arrays["truth_px"]).T))
        self._lost = max(self._lost, int(arrays["held"].sum()))
        if moved_px.max() > self._largest_px:
            self._largest_px, self._best = float(moved_px.max()), (meta, arrays)

    @property
    def number(self) -> int:
        """Number of the last frame taken."""
        return self._number

    def summary(self) -> dict[str, Any]:
        """Return the figures of the session so far."""
        last, errors_px = self._last, np.array(self._errors_px).ravel()
        played_s = (last.get("t_us", 0) - last.get("t_start_us", 0)) / 1e6
        document = {
            "played_s": round(played_s, 3),
            "estimates": last.get("steps", 0),
            "step_p50_us": last.get("step_p50_us", 0.0),
            "step_p99_us": last.get("step_p99_us", 0.0),
            "contacts": len(last.get("contacts_us", [])),
            "displacement_max_px": round(max(self._largest_px, 0.0), 3),
            "held_at_once": self._lost,
            "losses": last.get("losses", {}),
        }
        if len(errors_px):
            document["error_mean_px"] = round(float(errors_px.mean()), 4)
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
        rows = sorted(self._rows, key=lambda row: row[0])
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
                t_s=np.array([row[0] for row in rows]),
                displacement_px=np.array([row[2] for row in rows]),
                rate_kev_s=np.array([row[1] for row in rows]),
                contacts_s=tuple((t_us - start_us) / 1e6 for t_us in self._last["contacts_us"]),
            ),
        )
        return True
