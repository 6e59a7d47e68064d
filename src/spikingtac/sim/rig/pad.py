"""Skin of a gel pad under the motion of the rod, as a sum of the six unit responses."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from spikingtac.arrays import FloatArray
from spikingtac.sim.rig.pad_response import MODES, PatchConfig, pad_response
from spikingtac.sim.rig.probe import ProbeState
from spikingtac.sim.scene.scene import SkinConfig
from spikingtac.sim.states import SkinState

NORMAL_MODE = 2
"""Index of the translation along the pad's z; see :mod:`spikingtac.sim.rig.pad_response`."""


@dataclass(frozen=True, kw_only=True)
class PadConfig:
    """Position of a pad on the rod.

    Attributes:
        skin: The markers. The second finger carries the next serial number.
        grip_mm: Depth by which the grip presses the rod into the pad, mm (ours: 10 % of the layer).
        half_thickness_mm: Distance from the rod's axis to the skin, mm (a 4 mm rod).
    """

    skin: SkinConfig = field(default_factory=SkinConfig)
    grip_mm: float = 0.3
    half_thickness_mm: float = 2.0


PADS = 2
"""Number of pads that share the load of the rod, with or without a camera."""


class Pad:
    """One pad. The patch that sticks to the rod lies in the middle of its markers.

    Args:
        config: Position of the pad on the rod.
        patch: The patch that sticks to the rod.
        faces_back: False for pad A; True for pad B, whose camera looks in the opposite direction.
    """

    def __init__(self, config: PadConfig, patch: PatchConfig, faces_back: bool = False) -> None:
        rest = config.skin.rest_mm()
        response = pad_response(patch, rest)
        self._fields = np.concatenate(
            [response.displacement.reshape(MODES, -1), response.gradient.reshape(MODES, -1)], axis=1
        )
        self._from_bushing = mode_amplitudes(config.half_thickness_mm, faces_back)
        self._grip = np.zeros(MODES)
        self._grip[NORMAL_MODE] = config.grip_mm
        places = np.column_stack([rest, np.zeros(len(rest))])
        undeformed = np.tile(np.eye(2), (len(rest), 1, 1))
        self._rest = np.concatenate([places.ravel(), undeformed.ravel()])
        self._coordinates = places.size

    def skin(self, state: ProbeState, rotation: FloatArray) -> SkinState:
        """Return the skin under the rod.

        Args:
            state: State of the probe.
            rotation: ``(3, 3)`` axes of the gripper as columns in the base frame.
        """
        amplitude = self._grip + self._from_bushing @ state.bushing
        fields = self._rest + amplitude @ self._fields
        places, gradient = fields[: self._coordinates], fields[self._coordinates :]
        axes = self._from_bushing[:3, :3] @ rotation.T
        force, lever = axes @ state.force_n / PADS, axes @ (state.tip_mm - state.center_mm)
        (x, y, z), (fx, fy, fz) = lever.tolist(), force.tolist()
        return SkinState(
            t_us=state.t_us,
            marker_mm=places.reshape(-1, 3),
            gradient=gradient.reshape(-1, 2, 2),
            force_n=force,
            torque_n_mm=np.array([y * fz - z * fy, z * fx - x * fz, x * fy - y * fx]),
            pose_mm=axes @ state.tip_mm,
            in_contact=True,
        )


def mode_amplitudes(half_thickness_mm: float, faces_back: bool) -> FloatArray:
    """Return ``(6, 6)``: amplitudes of the pad's modes per bushing motion (gripper frame).

    Pad A sees the gripper's x and y as its own and z reversed; pad B sees x reversed. A rotation of
    the rod also moves its surface, which lies half a thickness away from its axis.
    """
    side = 1.0 if faces_back else -1.0
    out = np.zeros((MODES, MODES))
    out[0, 0], out[1, 1], out[2, 2] = -side, 1.0, side
    out[3, 5] = -side
    out[4, 4] = 1.0
    out[5, 3] = side
    out[0, 4] = -half_thickness_mm
    out[1, 3] = -side * half_thickness_mm
    return out
