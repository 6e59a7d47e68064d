"""Four discs that sway, as ideal pixels with equal thresholds see them."""

from collections.abc import Iterable
from functools import cache

import numpy as np

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.calibration.recording import BufferedEvents
from stand_ins.known import known
from stand_ins.rare_off import RADIUS_PX, SIZE, levels

REST_PX = np.array([[24.0, 20.0], [60.0, 20.0], [24.0, 46.0], [60.0, 46.0]])
STEP, PERIOD_US, SAMPLES = 0.12, 1_000, 1_500
PROFILE = DiscProfile(4.0, 0.7)


def ways_px() -> np.ndarray:
    phase = np.linspace(0.0, 6.0 * np.pi, SAMPLES)
    return np.column_stack([8.0 * np.sin(phase), 5.0 * np.sin(0.5 * phase)])


def fired(maps: Iterable[np.ndarray], step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return sample, pixel and polarity of the events of ideal pixels that follow levels."""
    known, events = None, []
    for sample, level in enumerate(maps):
        now = level.ravel()
        known = now.copy() if known is None else known
        for rises in (1, 0):
            sign = 1.0 if rises else -1.0
            while len(pixels := np.flatnonzero(sign * (now - known) > step)):
                known[pixels] += sign * step
                events.append([0 * pixels + sample, pixels, 0 * pixels + rises])
    sample, pixel, rises = np.concatenate(events, axis=1)
    return sample, pixel, rises


@cache
def swaying_discs() -> BufferedEvents:
    maps = (levels(REST_PX + way_px, PROFILE) for way_px in ways_px())
    sample, pixel, rises = fired(maps, STEP)
    columns = (2 * pixel + rises).astype(np.uint32), (sample * PERIOD_US).astype(np.uint32)
    return BufferedEvents(*columns, SIZE, 0, SAMPLES * PERIOD_US)


def calibration(step: float) -> Calibration:
    edge = {"contrast": PROFILE.contrast, "edge_px": PROFILE.edge_px, "lag_us": 0.0}
    return known(REST_PX, RADIUS_PX, SIZE, step=step, **edge)
