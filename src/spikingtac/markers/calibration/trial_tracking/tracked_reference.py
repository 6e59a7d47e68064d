"""Where the tracker finds the markers at rest, if other steps suit it than explain the events.

Where OFF and ON steps had to be scaled apart
(:mod:`spikingtac.markers.calibration.trial_tracking.step_scale`), no model of the sensor explains
all of its events, and the tracker comes back from every contact to places that agree with each
other, but not with those that all events together tell: on the recorded sensor they agree to
0.3 px and lie 1 px away, where the latter drift by 1.2 px from rest to rest. What is asked for is a
displacement that vanishes at rest, so that the tracker's own rests are the reference. So they are
where pixels recover (simulated: rests known to 0.16 px instead of 0.19). Ours.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.calibration.buffered_events import BufferedEvents
from spikingtac.markers.calibration.reference import CREPT_SHARE, typical
from spikingtac.markers.calibration.trial_tracking.step_scale import track


def with_tracked_reference(
    events: BufferedEvents, calibration: Calibration, rests_us: NDArray[np.int64]
) -> Calibration:
    """Return a calibration whose reference is where the tracker finds the markers after contacts.

    It is the same calibration if its ON and OFF steps were scaled alike and pixels do not recover.

    Args:
        events: The recording, markers brighter than the ground.
        calibration: Its steps are those that suit the tracker.
        rests_us: ``(rests, 2)`` when nothing touched the skin, us since the start of the recording.
            The first one is left out: at it the tracker stands where it was put.
    """
    own_rests = calibration.steps_scaled_apart or calibration.recovery_s is not None
    if not own_rests or len(rests_us) < 2:
        return calibration
    after_us = rests_us[1:]
    t_us, center_px = track(events, calibration)
    length_us = np.diff(after_us, axis=1)[:, 0]
    first = np.searchsorted(t_us, after_us[:, 0] + (CREPT_SHARE * length_us).astype(np.int64))
    last = np.searchsorted(t_us, after_us[:, 1])
    rest_px = np.array([
        np.median(center_px[begin : max(end, begin) + 1], axis=0)
        for begin, end in zip(first.clip(0, len(t_us) - 1), last, strict=True)
    ])  # fmt: skip
    found_px = typical(rest_px, length_us)
    if calibration.marker_measured is not None:
        measured = calibration.marker_measured[:, np.newaxis]
        found_px = np.where(measured, found_px, calibration.reference_px)
    return replace(calibration, reference_px=found_px)
