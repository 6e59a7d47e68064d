"""ur_rtde's native client: how it is connected, and how it is let go of where it hangs."""

from __future__ import annotations

import contextlib
import ctypes
import threading
from collections.abc import Callable
from typing import Any

from spikingtac.errors import DeviceError, MissingExtraError
from spikingtac.robot.bounded_calls import step_down
from spikingtac.robot.ur_ports import require_controller

RECEIVED = [
    "timestamp", "actual_TCP_pose", "actual_TCP_speed", "target_TCP_speed", "robot_status_bits",
    "safety_status_bits", "runtime_state",
]  # fmt: skip
"""What is asked of the controller: enough for the protocol, little enough for CB3 at 125 Hz."""


DISCONNECT_S = 3.0
"""Longest wait for an interface to disconnect, or for its last call, s (ur_rtde's own take half a
second each; a call on a silent controller returns after 2.8)."""


def connect(host: str, limit_s: float) -> tuple[Any, Any]:
    """Return ur_rtde's receive and control interfaces.

    Args:
        host: Address of the controller.
        limit_s: Longest wait for the first answer of each port, s.

    Raises:
        MissingExtraError: ur_rtde is not installed.
        DeviceError: The controller does not answer, or refuses.
    """
    try:
        import rtde_control
        import rtde_receive
    except ImportError as error:
        raise MissingExtraError(
            "the UR driver needs ur_rtde; install it with: pip install 'spikingtac[robot]'"
        ) from error
    require_controller(host, limit_s)
    try:
        receive = rtde_receive.RTDEReceiveInterface(host, -1.0, RECEIVED)
        return receive, rtde_control.RTDEControlInterface(host)
    except Exception as error:  # ur_rtde raises RuntimeError, logic_error and others
        raise DeviceError(
            f"no UR controller answers at {host}: {error}; "
            "check address, power and that remote control is on"
        ) from error


def disconnect(interface: Any, hangs: bool) -> None:
    """Disconnect an interface, or abandon it where that takes longer than a limit.

    Args:
        interface: Receive or control interface.
        hangs: Whether a call into it has not returned; it is abandoned at once then.
    """
    if not hangs and _ends(interface.disconnect, DISCONNECT_S):
        return
    # Freed, it would wait for its own threads, and the interpreter with it: it is never freed.
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(interface))


def _ends(work: Callable[[], Any], limit_s: float) -> bool:
    """Run a native call in a thread and return whether it came back in time."""

    def run() -> None:
        step_down()  # it may wait without letting go of the core
        with contextlib.suppress(Exception):  # whatever a broken native client raises
            work()

    thread = threading.Thread(target=run, name="ur-disconnect", daemon=True)
    thread.start()
    thread.join(limit_s)
    return not thread.is_alive()
