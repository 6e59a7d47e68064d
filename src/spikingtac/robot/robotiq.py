"""A Robotiq gripper through its URCap's ASCII socket (port 63352).

The protocol sets and reads variables: the answer to ``SET POS 255`` is ``ack``, that to ``GET POS``
is ``POS 255``. Positions, speeds and forces are 0 to 255; 0 is open.
"""

from __future__ import annotations

import contextlib
import enum
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass

from spikingtac.errors import ConfigError, DeviceError

PORT = 63352
FULL_SCALE = 255
LONGEST_ANSWER = 1024  # Bytes that may come before the end of an answer.
ACTIVE = 3  # Value of ``STA`` once the activation has ended.

# From this value on ``FLT`` is a major fault, below a warning (Robotiq 2F manual).
FAULTS_THAT_STOP = 8
POLL_S = 0.02  # Time between two looks, s.


class Grip(enum.IntEnum):
    """What the fingers found: the values of ``OBJ``."""

    MOVING = 0
    HELD_OPENING = 1
    HELD_CLOSING = 2
    AT_POSITION = 3


@dataclass(frozen=True, kw_only=True)
class RobotiqConfig:
    """How to talk to the gripper.

    Attributes:
        port: Port of the URCap's socket.
        timeout_s: Longest wait for an answer, s; to its end, however slowly it comes.
        activation_s: Longest wait for the activation, s.
        motion_s: Longest wait for a motion, s.
    """

    port: int = PORT
    timeout_s: float = 1.0
    activation_s: float = 10.0
    motion_s: float = 5.0


class RobotiqGripper:
    """A gripper on the network; a context manager that closes its connection.

    Args:
        host: Address of the robot's controller.
        config: How to talk to it.
        sleep: Waits for so many seconds.

    Raises:
        DeviceError: Nothing answers.
    """

    def __init__(
        self,
        host: str,
        config: RobotiqConfig | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._config = config or RobotiqConfig()
        self._sleep = sleep
        self._rest = b""
        address = (host, self._config.port)
        try:
            self._socket = socket.create_connection(address, self._config.timeout_s)
        except OSError as error:
            raise DeviceError(
                f"no gripper answers at {host}:{self._config.port}: {error}; "
                "check that the Robotiq URCap is installed and the controller is on"
            ) from error

    def __enter__(self) -> RobotiqGripper:
        return self

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
        self._until(lambda: self.get("STA") == ACTIVE, self._config.activation_s, "activate")
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
        self._until(lambda: self.get("PRE") == position, self._config.motion_s, "take the goal")
        self._until(lambda: self.get("OBJ") != Grip.MOVING, self._config.motion_s, "end its motion")
        return Grip(self.get("OBJ"))

    def position(self) -> int:
        """Return the fingers' position, 0 (open) to 255 (closed)."""
        return self.get("POS")

    def set(self, name: str, value: int) -> None:
        """Set one variable.

        Raises:
            DeviceError: It is not acknowledged.
        """
        answer = self._ask(f"SET {name} {value}")
        if answer != "ack":
            raise DeviceError(f"the gripper answered {answer!r} to SET {name} {value}")

    def get(self, name: str) -> int:
        """Return one variable, 0 to 255.

        Raises:
            DeviceError: The answer is none.
        """
        answer = self._ask(f"GET {name}").split()
        if len(answer) != 2 or answer[0] != name or not answer[1].isdecimal():
            raise DeviceError(f"the gripper answered {' '.join(answer)!r} to GET {name}")
        value = int(answer[1])
        if value > FULL_SCALE:
            raise DeviceError(
                f"the gripper answered {' '.join(answer)!r} to GET {name}; valid is up to "
                f"{FULL_SCALE}"
            )
        return value

    def _ask(self, line: str) -> str:
        until_s = time.monotonic() + self._config.timeout_s
        try:
            self._socket.settimeout(self._config.timeout_s)
            self._socket.sendall(line.encode() + b"\n")
            return self._read(until_s)
        except OSError as error:
            raise DeviceError(f"the gripper does not answer to {line!r}: {error}") from error

    def _read(self, until_s: float) -> str:
        """Return one answer; ``ack`` may come without an end of line."""
        while b"\n" not in self._rest and self._rest != b"ack":
            left_s = until_s - time.monotonic()
            if left_s <= 0.0 or len(self._rest) > LONGEST_ANSWER:
                raise TimeoutError("no whole answer came in time")
            self._socket.settimeout(left_s)
            data = self._socket.recv(1024)
            if not data:
                raise ConnectionResetError("the connection was closed")
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        return line.decode(errors="replace").strip()

    def _until(self, done: Callable[[], bool], patience_s: float, what: str) -> None:
        for _ in range(max(round(patience_s / POLL_S), 1)):
            fault = self.get("FLT")
            if fault >= FAULTS_THAT_STOP:
                raise DeviceError(f"the gripper reports fault {fault}; see its manual")
            if done():
                return
            self._sleep(POLL_S)
        with contextlib.suppress(DeviceError):
            self.set("GTO", 0)
        raise DeviceError(f"the gripper did not {what} within {patience_s} s")
