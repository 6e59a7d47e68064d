"""The simulated arm as real time passes, which ``twin:`` opens."""

from __future__ import annotations

import time

import numpy as np

from spikingtac.arrays import FloatArray
from spikingtac.errors import DeviceError
from spikingtac.robot.arm import ArmState
from spikingtac.sim.rig.ur3 import UR3Config, UR3Twin
from spikingtac.types import Pose

# Longest wait for the end of a stop, and time between two looks, s; a UR3 at full speed stops
# within 0.15 s.
STOP_S, POLL_S = 0.2, 0.002


class RealTimeArm(UR3Twin):
    """A simulated UR3 that starts at the origin; its time is the host's.

    Args:
        seed: Seed of controller phase, servo lag and repeatability.
    """

    def __init__(self, seed: int = 0) -> None:
        super().__init__(UR3Config(), np.zeros(3), np.random.default_rng(seed))
        self._zero_s = time.monotonic()

    def pose(self) -> Pose:
        """Return the last reported pose; see :class:`~spikingtac.robot.arm.Arm`."""
        self._wake()
        return super().pose()

    def speed_mm_s(self) -> FloatArray:
        """Return the last reported velocity ``(3,)``, mm/s."""
        self._wake()
        return super().speed_mm_s()

    def true_position_mm(self) -> FloatArray:
        """Return the true position ``(3,)`` now, mm."""
        self._wake()
        return super().true_position_mm()

    def stop(self) -> None:
        """Brake; see :class:`~spikingtac.robot.arm.Arm`."""
        self._wake()
        super().stop()

    def confirm_stop(self) -> None:
        """Wait until the arm rests; see :class:`~spikingtac.robot.arm.Arm`."""
        until_s = time.monotonic() + STOP_S
        while self.state() is ArmState.MOVING:
            if time.monotonic() > until_s:
                raise DeviceError("the simulated arm still moves; nothing told it to stop")
            time.sleep(POLL_S)

    def state(self) -> ArmState:
        """Return what the arm does now."""
        self._wake()
        return super().state()

    def _wake(self) -> None:
        now_us = round(1e6 * (time.monotonic() - self._zero_s))
        self.advance_to(max(now_us, self._now_us))
