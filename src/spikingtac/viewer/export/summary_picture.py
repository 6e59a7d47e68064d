"""A tracked stretch as one picture: the moment of largest displacement beside the whole course."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from spikingtac.errors import ConfigError
from spikingtac.plots.summary import Course, Picture, save_summary
from spikingtac.viewer.export.animation import picture_of
from spikingtac.viewer.export.stretch import US_PER_S, open_stretch
from spikingtac.viewer.playback import Playback
from spikingtac.viewer.session.source import ViewSource

MOST_ROWS = 4_000
"""Moments of the course: more than a figure has pixels."""
STEP_US = 10_000
"""Least time between two of them, us."""
RATED_US = 50_000
"""Time in which events are counted for their rate, us."""


def export_picture(view: ViewSource, path: str | Path, *, seconds: float | None = None) -> int:
    """Track a view and write what `view --picture` shows at its end; return 1, a picture.

    Args:
        view: From :func:`spikingtac.viewer.session.opening.open_view_source`.
        path: File to write: ``.png``, ``.svg`` or ``.pdf``.
        seconds: Length of the stretch from its beginning; None is all of it.

    Raises:
        ConfigError: The source does not end and no length was given, or nothing was tracked.
    """
    t_us, moved_px, rate_ev_s = [], [], []
    best: Picture | None = None
    largest_px = -1.0
    reference_px = view.calibration.reference_px
    with open_stretch(view, seconds) as stretch:
        playback, start_us = stretch.playback, stretch.playback.store.t_start_us
        step_us = max((stretch.end_us - start_us) // MOST_ROWS, STEP_US)
        while stretch.advance(step_us):
            frame = playback.frame
            if frame is None:
                continue
            t_us.append(frame.t_us - start_us)
            moved_px.append(np.hypot(*(frame.position_px - reference_px).T).astype(np.float32))
            rate_ev_s.append(_rate_ev_s(playback))
            if moved_px[-1].max() > largest_px:
                largest_px, best = float(moved_px[-1].max()), picture_of(stretch)
        contacts_s = tuple((one_us - start_us) / US_PER_S for one_us in sorted(playback.contacts))
    if best is None:
        raise ConfigError(f"{view.label}: too short, nothing was tracked")
    course = Course(
        t_s=np.array(t_us) / US_PER_S,
        displacement_px=np.array(moved_px),
        rate_kev_s=np.array(rate_ev_s) / 1e3,
        contacts_s=contacts_s,
    )
    save_summary(path, f"{view.label}{' (simulated)' if view.simulated else ''}", best, course)
    return 1


def _rate_ev_s(playback: Playback) -> float:
    """Return the events per second just before the position."""
    now_us = playback.position_us
    since_us = max(now_us - RATED_US, playback.store.t_start_us)
    return len(playback.store.between(since_us, now_us)) * US_PER_S / max(now_us - since_us, 1)
