"""A tracked stretch as ``.rrd``, which the Rerun viewer opens: image, arrows, curves, contacts.

A file only. A connected Rerun viewer that reads slowly holds up whoever sends to it, and it listens
on every interface of the machine.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.errors import ConfigError, MissingExtraError
from spikingtac.live.event_store import EventStore
from spikingtac.live.playback import Playback
from spikingtac.viewer.session.layers import OFF_CODE, activity, unpack, view_size, view_step
from spikingtac.viewer.session.source import ViewSource

STEP_US = 10_000
"""Span of an entry: 100 per second, as in the MCAP export."""
EXPOSURE_US = 30_000
BUDGET_S = 3600.0
GREY, ON_GREY, OFF_GREY = 128, 255, 0
US_PER_S = 1_000_000
TIMELINE = "sensor_time"


def export_rrd(subject: ViewSource, path: str | Path, *, seconds: float | None = None) -> int:
    """Track a subject and write what a page would show; return the number of entries.

    Args:
        subject: From :func:`spikingtac.viewer.session.opening.open_view_source`.
        path: File to write.
        seconds: Length of the stretch; None is all of it, which a source that goes on has not.

    Raises:
        MissingExtraError: The extra ``[rerun]`` is not installed.
        ConfigError: The source does not end and no length was given.
    """
    try:
        rerun: Any = importlib.import_module("rerun")
    except ImportError as error:
        raise MissingExtraError("RRD needs: pip install 'spikingtac[rerun]'") from error
    if seconds is None and not subject.ends:
        raise ConfigError("this source does not end by itself; say how long: --seconds N")
    store = EventStore(subject.source)
    playback = Playback(
        store,
        lambda: subject.make_tracker(subject.config),
        subject.make_detector,
        rate_hz=subject.rate_hz,
    )
    end_us = None if seconds is None else store.t_start_us + round(seconds * US_PER_S)
    stream: Any = rerun.RecordingStream("spikingtac", recording_id=subject.label)
    stream.save(path)
    try:
        return _write(rerun, stream, subject, playback, end_us)
    finally:
        stream.flush()
        stream.disconnect()
        store.close()


def _write(
    rerun: Any, stream: Any, subject: ViewSource, playback: Playback, end_us: int | None
) -> int:
    entries, contacts = 0, set[int]()
    while end_us is None or playback.position_us < end_us:
        start_us = playback.position_us
        playback.aim(start_us + STEP_US if end_us is None else min(start_us + STEP_US, end_us))
        playback.work(BUDGET_S)
        if playback.position_us == start_us:
            break
        since_us = playback.position_us - playback.store.t_start_us
        stream.set_time(TIMELINE, duration=np.timedelta64(since_us, "us"))
        _log_moment(rerun, stream, subject, playback)
        for t_us in sorted(playback.contacts.keys() - contacts):
            stream.log("contacts", rerun.TextLog(f"contact at {t_us} us"))
        contacts |= playback.contacts.keys()
        entries += 1
    return entries


def _log_moment(rerun: Any, stream: Any, subject: ViewSource, playback: Playback) -> None:
    store, frame, now_us = playback.store, playback.frame, playback.position_us
    exposed = store.between(now_us - EXPOSURE_US, now_us)
    codes = unpack(activity(exposed), view_size(store.size))
    grey = np.where(codes == 0, GREY, np.where(codes < OFF_CODE, ON_GREY, OFF_GREY))
    stream.log("sensor/events", rerun.Image(grey.astype(np.uint8), color_model="L"))
    events = len(store.between(now_us - STEP_US, now_us))
    stream.log("rate/events_per_s", rerun.Scalars(events * US_PER_S / STEP_US))
    if frame is None:
        return
    step, moved_px = view_step(store.size), frame.displacement_px
    origins = subject.calibration.reference_px / step
    stream.log("sensor/displacement", rerun.Arrows2D(origins=origins, vectors=moved_px / step))
    stream.log("displacement_px/largest", rerun.Scalars(float(np.hypot(*moved_px.T).max())))
    stream.log("markers/held", rerun.Scalars(int(frame.coasted.sum())))
