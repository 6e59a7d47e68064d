"""Every variant differs from the default in what it says, builds, and estimates."""

import numpy as np
import pytest

from spikingtac.types import EventPacket
from spikingtac_paper.point_tracking.ablation import (
    ABLATION_SCENES,
    ablation_methods,
    ablation_trials,
    methods_on,
)
from stand_ins.known import known
from stand_ins.moving_rims import GRID, RADIUS_PX, SIZE

CALIBRATION = known(GRID, RADIUS_PX, SIZE, step=0.13, contrast=6.0)
METHODS = ablation_methods()
TRACKERS = [name for name, method in METHODS.items() if method.law is None]


@pytest.mark.parametrize("name", TRACKERS)
def test_a_variant_runs(name: str) -> None:
    method = METHODS[name]
    packet = EventPacket.empty(0, 10_000, SIZE)
    packets = [packet] if method.before is None else list(method.before([packet], CALIBRATION))
    tracker = method.build(CALIBRATION)
    for one in packets:
        tracker.absorb(one)
    frame = tracker.estimate(10_000)
    assert frame.detected_px.shape == (9, 2)
    # A reference that is 1 px off pulls the estimate by that much, nothing else does.
    off_px = np.linalg.norm(frame.detected_px - CALIBRATION.reference_px, axis=1)
    assert off_px.max() < (1.5 if "1px" in name else 0.3)


def test_every_trial_asks_the_default_and_each_variant_is_asked_somewhere() -> None:
    asked = [methods_on(trial) for trial in ablation_trials(range(0, 1), ABLATION_SCENES)]
    assert all("default" in names for names in asked)
    assert {name for names in asked for name in names} == set(METHODS)
