"""A Robotiq gripper through its URCap's ASCII socket (port 63352).

The protocol sets and reads variables: the answer to ``SET POS 255`` is ``ack``, that to ``GET POS``
is ``POS 255``. Positions, speeds and forces are 0 to 255; 0 is open.
"""

from __future__ import annotations

import contextlib
import enum
import re
import socket
import time
from collections.abc import Callable

from spikingtac.errors import ConfigError, DeviceError

PORT = 63352
FULL_SCALE = 255
LONGEST_ANSWER = 1024  # Bytes that may come before the end of an answer.
ACTIVE = 3  # Value of ``STA`` once the activation has ended.

# From this value on ``FLT`` is a major fault, below a warning (Robotiq 2F manual).
FAULTS_THAT_STOP = 8
POLL_S = 0.02  # Time between two looks, s.
ANSWER_S = 1.0  # Longest wait for the end of an answer, s, however slowly it comes.
ACTIVATION_S, MOTION_S = 10.0, 5.0  # Longest wait for the activation and for a motion, s.


class Grip(enum.IntEnum):
    """What the fingers found: the values of ``OBJ``."""

    MOVING = 0
    HELD_OPENING = 1
    HELD_CLOSING = 2
    AT_POSITION = 3


class RobotiqGripper(contextlib.AbstractContextManager["RobotiqGripper"]):
    """A gripper on the network; a context manager that closes its connection.

    Args:
        host: Address of the robot's controller.
        port: Port of the URCap's socket.

    Raises:
        DeviceError: Nothing answers.
    """

    def __init__(self, host: str, port: int = PORT) -> None:
        self._rest = b""
        try:
            self._socket = socket.create_connection((host, port), ANSWER_S)
        except OSError as error:
            raise DeviceError(
                f"no gripper answers at {host}:{port}: {error}; "
                "check that the Robotiq URCap is installed and the controller is on"
            ) from error

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection; the fingers stay where they are."""
        self._socket.close()

    def activate(self) -> None:
        """Activate the gripper, if it is not active yet.

        Raises:
            DeviceError: It reports a fault, or is not active in time.
        """
        if self.get("STA") != ACTIVE:
            self.set("ACT", 0)
            self.set("ACT", 1)
        self._until(lambda: self.get("STA") == ACTIVE, ACTIVATION_S, "activate")
        self.set("GTO", 1)

    def move(self, position: int, speed: int = FULL_SCALE, force: int = 0) -> Grip:
        """Move the fingers and wait.

        Args:
            position: 0 (open) to 255 (closed).
            speed: 0 to 255.
            force: 0 to 255; 0 is the gentlest, and does not grip again when the object slips.

        Returns:
            Whether the position was reached, or an object held before.

        Raises:
            ConfigError: A value is out of range.
            DeviceError: The gripper reports a fault, or does not end its motion in time.
        """
        for name, value in (("position", position), ("speed", speed), ("force", force)):
            if not 0 <= value <= FULL_SCALE:
                raise ConfigError(f"the gripper's {name} is {value}, valid are 0 to {FULL_SCALE}")
        self.set("SPE", speed)
        self.set("FOR", force)
        self.set("POS", position)
        self._until(lambda: self.get("PRE") == position, MOTION_S, "take the goal")
        self._until(lambda: self.get("OBJ") != Grip.MOVING, MOTION_S, "end its motion")
        return Grip(self.get("OBJ"))

    def position(self) -> int:
        """Return the fingers' position, 0 (open) to 255 (closed)."""
        return self.get("POS")

    def set(self, name: str, value: int) -> None:
        """Set one variable.

        Raises:
            DeviceError: It is not acknowledged.
        """
        if (answer := self._ask(f"SET {name} {value}")) != "ack":
            raise DeviceError(f"the gripper answered {answer!r} to SET {name} {value}")

    def get(self, name: str) -> int:
        """Return one variable, 0 to 255.

        Raises:
            DeviceError: The answer is none.
        """
        answer = self._ask(f"GET {name}")
        found = re.fullmatch(rf"{name}\s+(\d{{1,3}})", answer)
        if found is None or int(found[1]) > FULL_SCALE:
            raise DeviceError(
                f"the gripper answered {answer!r} to GET {name}; valid is {name} and a "
                f"number up to {FULL_SCALE}"
            )
        return int(found[1])

    def _ask(self, line: str) -> str:
        until_s = time.monotonic() + ANSWER_S
        try:
            self._socket.settimeout(ANSWER_S)
            self._socket.sendall(line.encode() + b"\n")
            while b"\n" not in self._rest and self._rest != b"ack":  # which may end without a line
                left_s = until_s - time.monotonic()
                if left_s <= 0.0 or len(self._rest) > LONGEST_ANSWER:
                    raise TimeoutError("no whole answer came in time")
                self._socket.settimeout(left_s)
                data = self._socket.recv(1024)
                if not data:
                    raise ConnectionResetError("the connection was closed")
                self._rest = (self._rest + data).lstrip(b"\n")  # the end of a split "ack"
        except OSError as error:
            self._socket.close()  # an answer that comes yet would be taken for the next one
            raise DeviceError(
                f"the gripper does not answer to {line!r}: {error}; connect anew"
            ) from error
        answer, _, self._rest = self._rest.partition(b"\n")
        return answer.decode(errors="replace").strip()

    def _until(self, done: Callable[[], bool], patience_s: float, what: str) -> None:
        until_s = time.monotonic() + patience_s
        while (fault := self.get("FLT")) < FAULTS_THAT_STOP:
            if done():
                return
            if time.monotonic() > until_s:
                with contextlib.suppress(DeviceError):
                    self.set("GTO", 0)
                raise DeviceError(f"the gripper did not {what} within {patience_s} s")
            time.sleep(POLL_S)
        raise DeviceError(f"the gripper reports fault {fault}; see its manual")
