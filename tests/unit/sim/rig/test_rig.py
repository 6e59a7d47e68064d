"""The rig's clock: arm, probe, skin and cameras advance together (with cameras that count)."""

from collections.abc import Sequence

import numpy as np
import pytest

from spikingtac.sim.optics import MarkerImage, SkinState
from spikingtac.sim.rig.rig import Rig, RigConfig
from spikingtac.sim.rig.walls import PlaneWall
from spikingtac.types import EventPacket

WALL = PlaneWall(point_mm=(1.375, 0.0, 0.0), normal=(-1.0, 0.0, 0.0))
PX_PER_MM = 15.5


class PlainFinger:
    """A pinhole without lens, and a camera that reports one event per image."""

    def __init__(self) -> None:
        self.images: list[MarkerImage] = []

    def project(self, state: SkinState) -> MarkerImage:
        count = len(state.marker_mm)
        center = PX_PER_MM * state.marker_mm[:, :2]
        return MarkerImage(state.t_us, center, np.tile(np.eye(2), (count, 1, 1)), np.ones(count))

    def settle(self, image: MarkerImage) -> None:
        self.images = [image]

    def advance(self, images: Sequence[MarkerImage]) -> EventPacket:
        start_us = self.images[-1].t_us
        self.images += images
        t = np.array([image.t_us - 1 for image in images], np.int64)
        zero = np.zeros(len(t), np.uint16)
        return EventPacket(zero, zero, zero > 0, t, start_us, images[-1].t_us, (320, 320))


def make_rig(rms_mm: float = 0.0, fingers: int = 2) -> tuple[Rig, list[PlainFinger]]:
    config = RigConfig(vibration_mm=rms_mm)
    plain = [PlainFinger() for _ in range(fingers)]
    return Rig(config, WALL, plain, np.zeros(3), np.random.default_rng(1)), plain


def test_the_first_touch_is_where_the_tip_meets_the_wall() -> None:
    rig, _ = make_rig()
    rig.arm.move_linear(np.array([3.0, 0.0, 0.0]), 5.0)
    while rig.first_contact is None:
        rig.advance(1000)
    assert rig.first_contact.arm_mm[0] == pytest.approx(1.0, abs=0.002)
    assert rig.t_us - 1000 <= rig.first_contact.t_us <= rig.t_us
    at_touch = rig.arm.position_at_mm(rig.first_contact.t_us)
    np.testing.assert_allclose(at_touch, rig.first_contact.arm_mm, atol=0.002)


def test_equal_seeds_and_any_pull_of_whole_steps_give_equal_states() -> None:
    ends = []
    for pulls in ([1000] * 60, [3000] * 20):
        rig, _ = make_rig(rms_mm=0.03)
        rig.arm.move_linear(np.array([3.0, 0.0, 0.0]), 50.0)
        for dt_us in pulls:
            rig.advance(dt_us)
        ends.append((rig.state.tip_mm, rig.state.bushing, rig.markers_px[1]))
    for first, second in zip(*ends, strict=True):
        np.testing.assert_allclose(first, second, atol=1e-12)
