"""A guided source passes every packet on, tells how it stands, and ends when enough has moved."""

from __future__ import annotations

import numpy as np

from spikingtac.events.source import PacketSource
from spikingtac.markers.calibration.advice import TELL_US, GuidedSource
from spikingtac.markers.calibration.guide import CalibrationGuide, GuideView
from spikingtac.types import EventPacket

SIZE = (16, 12)


class Ready(CalibrationGuide):
    """Says that all is there from a time on."""

    ready_us = 1 << 60

    @property
    def complete(self) -> bool:
        return self._t_us >= self.ready_us


class Closed(PacketSource):
    closed = False
    path = "camera"

    def close(self) -> None:
        self.closed = True


def packets(seconds: int) -> list[EventPacket]:
    return [EventPacket.empty(i * 100_000, (i + 1) * 100_000, SIZE) for i in range(10 * seconds)]


def test_everything_passes_and_is_told() -> None:
    told: list[GuideView] = []
    source = GuidedSource(Closed(packets(7), SIZE), CalibrationGuide(SIZE), told.append)
    assert len(list(source)) == 70
    times = [view.t_us for view in told]
    assert times[-1] == 7_000_000
    assert np.all(np.diff(times[:-1]) == TELL_US)
    assert source.path == "camera"
    assert source.size == SIZE
    assert not source.closed


def test_it_ends_when_enough_has_moved() -> None:
    guide, camera = Ready(SIZE), Closed(packets(7), SIZE)
    guide.ready_us = 3_000_000
    source = GuidedSource(camera, guide, lambda view: None, until_ready=True)
    assert len(list(source)) == 30
    assert camera.closed
