"""A tracked stretch as ``.rrd``, which the Rerun viewer opens: image, arrows, curves, contacts.

A file only. A connected Rerun viewer that reads slowly holds up whoever sends to it, and it listens
on every interface of the machine.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.errors import MissingExtraError
from spikingtac.viewer.export.stretch import US_PER_S, Stretch, open_stretch
from spikingtac.viewer.snapshot import grey_image, view_step
from spikingtac.viewer.source import ViewSource

STEP_US = 10_000  # Span of an entry: 100 per second, as in the MCAP export.
TIMELINE = "sensor_time"


def export_rrd(view: ViewSource, path: str | Path, *, seconds: float | None = None) -> int:
    """Track a view and write what a page would show; return the number of entries.

    Args:
        view: From :func:`spikingtac.viewer.opening.open_view_source`.
        path: File to write.
        seconds: Length of the stretch; None is all of it, where the source ends.

    Raises:
        MissingExtraError: The extra ``[rerun]`` is not installed.
        ConfigError: The source does not end and no length was given.
    """
    try:
        rerun: Any = importlib.import_module("rerun")
    except ImportError as error:
        raise MissingExtraError("RRD needs: pip install 'spikingtac[rerun]'") from error
    with open_stretch(view, seconds) as stretch:
        stream: Any = rerun.RecordingStream("spikingtac", recording_id=view.label)
        stream.save(path)
        try:
            return _write(rerun, stream, stretch)
        finally:
            stream.flush()
            stream.disconnect()


def _write(rerun: Any, stream: Any, stretch: Stretch) -> int:
    entries, contacts = 0, set[int]()
    playback = stretch.playback
    while playback.position_us < stretch.end_us and stretch.advance(STEP_US):
        since_us = playback.position_us - playback.store.t_start_us
        stream.set_time(TIMELINE, duration=np.timedelta64(since_us, "us"))
        _log(rerun, stream, stretch)
        for t_us in sorted(playback.contacts.keys() - contacts):
            stream.log("contacts", rerun.TextLog(f"contact at {t_us} us"))
        contacts |= playback.contacts.keys()
        entries += 1
    return entries


def _log(rerun: Any, stream: Any, stretch: Stretch) -> None:
    store, frame = stretch.playback.store, stretch.playback.frame
    now_us = stretch.playback.position_us
    image = grey_image(stretch.exposed())
    stream.log("sensor/events", rerun.Image(image, color_model="L"))
    events = len(store.between(now_us - STEP_US, now_us))
    stream.log("rate/events_per_s", rerun.Scalars(events * US_PER_S / STEP_US))
    if frame is None:
        return
    step, moved_px = view_step(store.size), frame.displacement_px
    origins = stretch.view.calibration.reference_px / step
    stream.log("sensor/displacement", rerun.Arrows2D(origins=origins, vectors=moved_px / step))
    stream.log("displacement_px/largest", rerun.Scalars(float(np.hypot(*moved_px.T).max())))
    stream.log("markers/held", rerun.Scalars(int(frame.coasted.sum())))
