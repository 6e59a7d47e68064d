"""The simulated sensor in MuJoCo: attach it to a model, or learn on tasks that need touch."""

from __future__ import annotations

from spikingtac_mujoco import gl

gl.choose()  # before MuJoCo is imported, which decides then

import gymnasium  # noqa: E402

from spikingtac_mujoco.pad import Mount, add_sensor, load_spec  # noqa: E402
from spikingtac_mujoco.sensor import Reading, Sensor  # noqa: E402

__all__ = ["Mount", "Reading", "Sensor", "add_sensor", "load_spec"]

# Name of a task -> its class; ``spikingtac/NAME-v0`` in Gymnasium.
TASKS = {
    "PegInHole": "spikingtac_mujoco.tasks.peg:PegInHole",
    "GripWithoutSlip": "spikingtac_mujoco.tasks.grip:GripWithoutSlip",
    "StopOnTouch": "spikingtac_mujoco.tasks.stop_on_touch:StopOnTouch",
}

for _name, _entry in TASKS.items():
    gymnasium.register(id=f"spikingtac/{_name}-v0", entry_point=_entry)
