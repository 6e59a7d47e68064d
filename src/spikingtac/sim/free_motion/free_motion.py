"""How a free probe sways: the response of the rod to a shaking arm, and of each disc to the rod.

Without contact the rod is a linear system. Its impulse response is taken from
:class:`~spikingtac.sim.rig.probe.Probe` itself, so that minutes of motion are one convolution.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import oaconvolve

from spikingtac.sim.optics.states import SkinState
from spikingtac.sim.rig.pad_modes import Pad
from spikingtac.sim.rig.probe import Probe, ProbeConfig
from spikingtac.sim.rig.vibration import Vibration
from spikingtac.sim.rig.walls import NoWall

Vector = NDArray[np.float64]

AXES, FREEDOMS = 3, 6
STEP_S = 0.001
"""Step of the mechanics, s: that of the rig away from the wall."""
RESPONSE_S = 1.5
"""Length of the impulse response, s: 25 decay times of the rocking mode (28 Hz, ratio 0.1); what
the creep chain keeps beyond it is below 0.1 % of the motion."""


class FreeMotion:
    """The motion of a probe that touches nothing while the arm shakes it.

    Args:
        config: The rod and its grip.
        vibration: Of the arm; a lead-in lets the rod forget that it began at rest.
    """

    def __init__(self, config: ProbeConfig, vibration: Vibration) -> None:
        self._response = impulse_response(config)
        self._vibration = vibration
        self._past_mm = vibration.path(len(self._response), STEP_S)

    def advance(self, steps: int) -> Vector:
        """Return the bushing ``(steps, 6)`` over so many milliseconds (mm and rad)."""
        shaken_mm = np.concatenate([self._past_mm, self._vibration.path(steps, STEP_S)])
        moved = np.zeros((len(shaken_mm), FREEDOMS))
        for axis in range(AXES):
            driven = oaconvolve(shaken_mm[:, axis, None], self._response[:, axis], axes=0)
            moved += driven[: len(moved)]
        self._past_mm = shaken_mm[-len(self._response) :]
        return moved[len(self._response) :]


@functools.lru_cache(maxsize=8)
def impulse_response(config: ProbeConfig) -> Vector:
    """Return ``(taps, 3, 6)``: the bushing after the arm was at 1 mm for one step, per axis."""
    taps = round(RESPONSE_S / STEP_S)
    response = np.empty((taps, AXES, FREEDOMS))
    for axis in range(AXES):
        probe = Probe(config, NoWall(), np.zeros(AXES))
        for tap in range(taps):
            arm_mm = np.zeros(AXES)
            arm_mm[axis] = float(tap == 0)
            response[tap, axis] = probe.step(tap + 1, STEP_S, arm_mm).bushing
    return response


def swayed_skin(pad: Pad, config: ProbeConfig, bushing: Vector) -> SkinState:
    """Return the skin of a pad under a free probe whose bushing is displaced by ``(6,)``."""
    at_rest = Probe(config, NoWall(), np.zeros(AXES)).at_rest(0)
    return pad.skin(replace(at_rest, bushing=bushing), config.rotation())
