"""Open an arm by its address."""

from __future__ import annotations

import importlib

from spikingtac.errors import ConfigError
from spikingtac.robot.arm import Arm
from spikingtac.robot.ur import URArm

# Module of the simulated arm, which is built on this package's protocol of an arm.
TWIN_ARM = "spikingtac.sim.rig.ur3"


def open_arm(address: str) -> Arm:
    """Return the arm at an address: a simulated one at ``twin:``, else a UR arm on the network.

    Raises:
        ConfigError: The address is empty, or ``twin:`` is followed by something.
        MissingExtraError: The arm's library is not installed.
        DeviceError: The controller does not answer, or refuses.
    """
    kind, colon, rest = address.partition(":")
    if not address or (kind == "twin" and (rest or not colon)):
        raise ConfigError(f"no arm {address!r} (valid: twin:, or the address of a UR arm)")
    if kind == "twin":  # loaded by name: the twin is built on this module
        return importlib.import_module(TWIN_ARM).RealTimeArm()
    return URArm(address)
