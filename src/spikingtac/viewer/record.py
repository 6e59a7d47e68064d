"""What is made of every estimate: the figures and the picture of a view's end."""

from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.errors import ConfigError
from spikingtac.plots.moments import Moment, Picture, save_summary
from spikingtac.types import US_PER_S, MarkerFrame
from spikingtac.viewer.playback import Playback
from spikingtac.viewer.snapshot import OFF_CODE, activity, events_per_s, view_step

EXPOSURE_US = 30_000  # Events of the last two frames of an ordinary camera, as on the page, us.

# Moments kept: 68 s at 60 per second; a longer record keeps every second, fourth... of them. A
# row of 64 markers holds 512 bytes, so that a record stays at some 3 MiB however long it lasts.
MOST_ROWS = 4_096


class Record:
    """Takes every estimate of a view, and its playback's state some times a second.

    Attributes:
        largest_px: Largest displacement of all estimates so far, px.
    """

    def __init__(self) -> None:
        self._rows: list[Moment] = []
        self._taken, self._every = 0, 1
        self._played_us = 0
        self._last_us: int | None = None
        self._shown: tuple[float, Picture] | None = None
        self._held = 0
        self.largest_px = 0.0

    def estimate(self, frame: MarkerFrame) -> None:
        """Take every estimate."""
        far_px = float(np.hypot(*frame.displacement_px.T).max(initial=0.0))
        self.largest_px = max(self.largest_px, far_px)
        self._held = max(self._held, int(frame.coasted.sum()))

    def take(self, playback: Playback) -> None:
        """Take the present state."""
        now_us, start_us = playback.position_us, playback.store.t_start_us
        self._played_us += max(now_us - (start_us if self._last_us is None else self._last_us), 0)
        if now_us == self._last_us:
            return
        self._last_us = now_us
        frame, truth = playback.state.frame, playback.view.truth
        moved_px, error_px = np.empty(0, np.float32), None
        if frame is not None:
            moved_px = np.hypot(*frame.displacement_px.T).astype(np.float32)
            truth_px = truth.at(frame.t_us) if truth and len(moved_px) else None
            if truth_px is not None:
                error_px = np.hypot(*(frame.detected_px - truth_px).T).astype(np.float32)
        largest_px = float(moved_px.max(initial=0.0))
        if self._shown is None or largest_px >= self._shown[0]:  # of events alone, the last moment
            self._shown = largest_px, picture_of(playback)
        self._taken += 1
        if self._taken % self._every == 0:
            since_s, rate_kev_s = (now_us - start_us) / US_PER_S, events_per_s(playback) / 1e3
            self._rows.append(Moment(since_s, rate_kev_s, moved_px, error_px))
        if len(self._rows) > MOST_ROWS:
            self._rows, self._every = self._rows[1::2], 2 * self._every

    def summary(self, playback: Playback) -> dict[str, Any]:
        """Return the figures so far."""
        p50_us, p99_us = playback.step_percentiles_us()
        frame, view = playback.state.frame, playback.view
        document: dict[str, Any] = {
            "played_s": round(self._played_us / US_PER_S, 3),
            "calibration": view.calibrated_by or None,
            "estimates": playback.steps if len(view.calibration.reference_px) else 0,
            "step_p50_us": round(p50_us, 1),
            "step_p99_us": round(p99_us, 1),
            "contacts": len(playback.contacts),
            "displacement_max_px": round(self.largest_px, 3),
            "held_at_once": self._held,
            "losses": dict(view.source.losses),
            "health": frame.health.summary() if frame else None,
        }
        errors_px = np.array([row.error_px for row in self._rows if row.error_px is not None])
        if len(errors_px):
            document["error_mean_px"] = round(float(errors_px.mean(dtype=np.float64)), 4)
            document["error_p95_px"] = round(float(np.percentile(errors_px, 95)), 4)
        return document

    def save_picture(self, path: Path, playback: Playback) -> None:
        """Write the moment of largest displacement beside the course.

        Raises:
            ConfigError: Nothing was shown.
        """
        view, start_us = playback.view, playback.store.t_start_us
        if self._shown is None:
            raise ConfigError(f"{view.label}: nothing was shown, there is nothing to draw")
        markers = max((len(row.moved_px) for row in self._rows), default=0)
        rows = [row for row in self._rows if len(row.moved_px) == markers]
        rows.sort(key=lambda row: row.t_s)
        contacts_s = [(t_us - start_us) / US_PER_S for t_us in sorted(playback.contacts)]
        title = f"{view.label}{' (simulated)' if view.simulated else ''}"
        save_summary(path, title, self._shown[1], rows, contacts_s)


def picture_of(playback: Playback) -> Picture:
    """Return what a page would show now."""
    frame, store, calibration = playback.state.frame, playback.store, playback.view.calibration
    now_us, step = playback.position_us, view_step(store.size)
    codes = activity(store.between(now_us - EXPOSURE_US, now_us))
    tracked = frame is not None and len(frame.position_px) == len(calibration.reference_px)
    position_px = frame.position_px if frame and tracked else calibration.reference_px
    return Picture(
        image=np.where(codes == 0, 0, np.where(codes < OFF_CODE, 1, 2)).astype(np.uint8),
        reference_px=calibration.reference_px / step,
        position_px=position_px / step,
        radius_px=calibration.radius_px / step,
        t_s=(now_us - store.t_start_us) / US_PER_S,
    )
