"""Motion of a free probe: the response of the rod to the vibration of the arm.

Without contact the rod is a linear system. Its impulse response is computed with
:class:`~spikingtac.sim.rig.probe.Probe` itself, so that minutes of motion are one convolution.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
from scipy.signal import oaconvolve

from spikingtac.arrays import FloatArray
from spikingtac.sim.optics.states import SkinState
from spikingtac.sim.rig.pad import Pad
from spikingtac.sim.rig.probe import Probe, ProbeConfig
from spikingtac.sim.rig.vibration import Vibration
from spikingtac.sim.rig.walls import NoWall

AXES, DEGREES_OF_FREEDOM = 3, 6
STEP_S = 0.001
"""Step of the mechanics, s; the same as that of the rig away from the wall."""
RESPONSE_S = 1.5
"""Length of the impulse response, s: 25 decay times of the rocking mode (28 Hz, damping ratio 0.1).
What the creep chain keeps for longer is below 0.1 % of the motion.
"""


class FreeMotion:
    """The motion of a probe without contact under the vibration of the arm.

    Args:
        config: The rod and its bushing.
        vibration: Vibration of the arm. A part of the length of the impulse response is drawn
            first, so that the rod does not start from rest.
    """

    def __init__(self, config: ProbeConfig, vibration: Vibration) -> None:
        self._response = impulse_response(config)
        self._vibration = vibration
        self._previous_mm = vibration.path(len(self._response), STEP_S)

    def advance(self, steps: int) -> FloatArray:
        """Return the bushing ``(steps, 6)`` over the next ``steps`` milliseconds (mm and rad)."""
        shaken_mm = np.concatenate([self._previous_mm, self._vibration.path(steps, STEP_S)])
        moved = np.zeros((len(shaken_mm), DEGREES_OF_FREEDOM))
        for axis in range(AXES):
            driven = oaconvolve(shaken_mm[:, axis, None], self._response[:, axis], axes=0)
            moved += driven[: len(moved)]
        self._previous_mm = shaken_mm[-len(self._response) :]
        return moved[len(self._response) :]


@functools.lru_cache(maxsize=8)
def impulse_response(config: ProbeConfig) -> FloatArray:
    """Return ``(taps, 3, 6)``: the bushing after the arm was at 1 mm for one step, per axis."""
    taps = round(RESPONSE_S / STEP_S)
    response = np.empty((taps, AXES, DEGREES_OF_FREEDOM))
    for axis in range(AXES):
        probe = Probe(config, NoWall(), np.zeros(AXES))
        for tap in range(taps):
            arm_mm = np.zeros(AXES)
            arm_mm[axis] = float(tap == 0)
            response[tap, axis] = probe.step(tap + 1, STEP_S, arm_mm).bushing
    return response


def skin_state(pad: Pad, config: ProbeConfig, bushing: FloatArray) -> SkinState:
    """Return the skin of a pad under a free probe with bushing displacement ``(6,)`` (mm, rad)."""
    at_rest = Probe(config, NoWall(), np.zeros(AXES)).at_rest(0)
    return pad.skin(replace(at_rest, bushing=bushing), config.rotation())
