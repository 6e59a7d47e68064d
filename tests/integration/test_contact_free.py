"""The fast path for contact-free motion against the whole twin, on one path of vibration."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.contact.registry import DetectionConfig, make_detector
from spikingtac.events.windows import windows
from spikingtac.sim.rig.pad import Pad
from spikingtac.sim.rig.probe import Grasp, Probe
from spikingtac.sim.rig.rig import VIBRATION_MM, SensingFinger
from spikingtac.sim.rig.walls import NoWall
from spikingtac.types import EventPacket
from spikingtac_paper.free_motion.free_rig import (
    FreeMotion,
    FreeRig,
    VibrationPath,
    skin_state,
)
from stand_ins.known import known
from stand_ins.random_packets import assert_equal

STEPS = 3_000
SEED = 7

# Ten false contacts a second: enough in three seconds to compare two rates.
BUDGET_PER_HOUR = 36_000.0


@dataclass(frozen=True)
class Both:
    fast: EventPacket
    whole: EventPacket
    calibration: Calibration


@pytest.fixture(scope="module", params=["typical", "noisy"])
def both(request: pytest.FixtureRequest) -> Both:
    pad = Pad()
    vibration = VibrationPath(VIBRATION_MM[request.param], np.random.default_rng(SEED))
    bushing = FreeMotion(vibration).advance(STEPS)
    free = FreeRig(request.param, SEED, history="random")
    whole = SensingFinger(request.param, SEED)
    skins = [skin_state(pad, one) for one in bushing]
    optics, camera = whole.optics, whole.camera
    camera.settle(optics.project(skin_state(pad, np.zeros(6))), "random")
    images = [optics.project(replace(skin, t_us=1000 * (k + 1))) for k, skin in enumerate(skins)]
    fast = free.camera.render_motion(bushing)
    rest = known(free.image.center_px, free.image.radius_px)
    return Both(fast, camera.advance(images), rest)


def per_window(packet: EventPacket) -> np.ndarray:
    return np.bincount(packet.t // 1000, minlength=STEPS)[:STEPS]


def test_a_free_probe_is_its_impulse_response() -> None:
    vibration_mm = VIBRATION_MM["noisy"]
    path = VibrationPath(vibration_mm, np.random.default_rng(3)).path(2_000, 0.001)
    vibration = VibrationPath(vibration_mm, np.random.default_rng(3))
    motion = FreeMotion(vibration)
    fast = np.concatenate([motion.advance(length) for length in (200, 1, 299)])
    probe = Probe(Grasp(), NoWall(), np.zeros(3))
    slow = [probe.step(k, 0.001, arm_mm).bushing for k, arm_mm in enumerate(path, 1)]
    assert np.abs(fast - slow[1_500:]).max() < 1e-3 * np.abs(fast).max()


def test_count_mean_and_variance_over_mean_agree(both: Both) -> None:
    fast, whole = per_window(both.fast), per_window(both.whole)
    assert fast.mean() == pytest.approx(whole.mean(), rel=0.02)
    assert fast.var() / fast.mean() == pytest.approx(whole.var() / whole.mean(), rel=0.06)
    assert np.percentile(fast, 99.5) == pytest.approx(np.percentile(whole, 99.5), rel=0.04)


@pytest.mark.parametrize("name", ["event_count", "default"])
def test_rates_of_false_stops_agree(both: Both, name: str) -> None:
    config = DetectionConfig(false_alarms_per_hour=BUDGET_PER_HOUR)
    alarms = []
    for packet in (both.fast, both.whole):
        quiet = list(windows([both.whole], 1000))
        detector = make_detector(name, config, [both.calibration], quiet)
        found = 0
        for window in windows([packet], 1000):
            if detector.update(window) is not None:
                found += 1
                detector.reset()
        alarms.append(found)
    # The streams share most events: their difference is well within that of two Poisson counts.
    assert alarms[1] > 0
    assert abs(alarms[0] - alarms[1]) <= 2.0 * np.sqrt(sum(alarms))


def test_any_cutting_into_stretches_gives_the_same_events() -> None:
    whole, cut = (FreeRig("noisy", SEED) for _ in range(2))
    parts = [cut.advance(400)[0] for _ in range(3)]
    assert_equal(EventPacket.concatenate(parts), whole.advance(1_200)[0])
