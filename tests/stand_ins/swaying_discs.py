"""Four discs that sway, as ideal pixels with equal thresholds see them."""

from functools import cache

import numpy as np

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.source import PacketSource
from stand_ins.known import known
from stand_ins.random_packets import decoded
from stand_ins.rare_off import RADIUS_PX, SIZE, fired, levels

REST_PX = np.array([[24.0, 20.0], [60.0, 20.0], [24.0, 46.0], [60.0, 46.0]])
STEP, PERIOD_US, SAMPLES = 0.12, 1_000, 1_500
PROFILE = DiscProfile(4.0, 0.7)


def ways_px() -> np.ndarray:
    phase = np.linspace(0.0, 6.0 * np.pi, SAMPLES)
    return np.column_stack([8.0 * np.sin(phase), 5.0 * np.sin(0.5 * phase)])


@cache
def swaying_discs() -> PacketSource:
    maps = (levels(REST_PX + way_px, PROFILE) for way_px in ways_px())
    sample, pixel, rises = fired(maps, STEP, STEP)
    whole = decoded(2 * pixel + rises, sample * PERIOD_US, SIZE, SAMPLES * PERIOD_US)
    return PacketSource([whole], SIZE)


def calibration(step: float) -> Calibration:
    edge = {"contrast": PROFILE.contrast, "edge_px": PROFILE.edge_px, "lag_us": 0.0}
    return known(REST_PX, RADIUS_PX, SIZE, step=step, **edge)
