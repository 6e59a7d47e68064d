"""Going back in a tracked stream, with the trackers that users have."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.events.source import PacketSource
from spikingtac.markers.registry import make_tracker
from spikingtac.sim.scene import catalog
from spikingtac.sim.scene.source import SceneSource
from spikingtac.types import EventPacket, MarkerFrame
from spikingtac.viewer.replay.event_store import EventStore
from spikingtac.viewer.replay.playback import Playback

RATE_HZ = 200.0
"""At every moment that is looked at, whatever the preset's rate."""
PLAYED_US = 1_300_000
TIMES_US = (500_000, 700_000, 900_000, 1_050_000, 1_300_000)
AGAIN_US = (900_000, 1_300_000, 500_000, 1_050_000, 700_000)


@pytest.fixture(scope="module")
def pressed() -> tuple[list[EventPacket], Calibration]:
    """The demo's first press, from the twin."""
    scene = catalog.load("demo")
    source = SceneSource(scene, seed=1)
    packets = []
    for step in source.steps():
        packets.append(step.packet)
        if step.packet.t_end_us >= PLAYED_US:
            break
    return packets, Calibration(
        reference_px=source.reference_px,
        radius_px=source.radius_px,
        grid=scene.skin.grid,
        size=scene.size,
    )


@pytest.mark.parametrize("preset", ["default", "fast", "paper"])
def test_a_time_that_is_gone_back_to_looks_as_it_did(
    preset: str, pressed: tuple[list[EventPacket], Calibration]
) -> None:
    packets, calibration = pressed
    config = load_config(preset).tracking
    store = EventStore(PacketSource(packets, calibration.size))
    playback = Playback(store, lambda: make_tracker(config, calibration), rate_hz=RATE_HZ)

    def shown(t_us: int) -> MarkerFrame:
        playback.aim(t_us)
        assert playback.work(600.0)
        assert playback.frame is not None
        return playback.frame

    before = {t_us: shown(t_us) for t_us in TIMES_US}
    moved_px = np.hypot(*before[PLAYED_US].displacement_px.T).max()
    assert moved_px > 5.0  # the press is under way, so a frozen map would show
    for t_us in AGAIN_US:
        again = shown(t_us)
        np.testing.assert_array_equal(again.detected_px, before[t_us].detected_px)
        np.testing.assert_array_equal(again.coasted, before[t_us].coasted)
    store.close()
