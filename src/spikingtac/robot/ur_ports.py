"""The open ports of a UR controller, and the means to stop its arm through them.

The open ports of a UR controller, each spoken to within a limit of time.

Dashboard server (29999) and script port (30002) take lines of text; RTDE (30004) takes packages.
They are independent of ur_rtde and of the program that runs on the controller. Sources: "Dashboard
server", "Remote control via TCP/IP" and "Real-time data exchange guide", universal-robots.com.

The means to stop a UR arm, the gentlest first.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass

from spikingtac.errors import DeviceError
from spikingtac.robot.verified_stop import Means, Report, StopConfig, VerifiedStop

DASHBOARD_PORT = 29999
SCRIPT_PORT = 30002
RTDE_PORT = 30004

# RTDE package: length, type, version of the protocol that is asked for.
ASK_PROTOCOL_2 = struct.pack(">HBH", 5, ord("V"), 2)
LONGEST_LINE = 4096  # Bytes of the longest line that is taken for an answer.


def send_script(host: str, script: str, limit_s: float) -> None:
    """Send a URScript program; it replaces the one that runs.

    Raises:
        DeviceError: It could not be sent within the limit.
    """
    try:
        with socket.create_connection((host, SCRIPT_PORT), limit_s) as connection:
            connection.sendall(script.encode())
    except OSError as error:
        raise DeviceError(f"no script could be sent to {host}:{SCRIPT_PORT}: {error}") from error


def dashboard(host: str, command: str, limit_s: float) -> str:
    """Give the dashboard server one command and return its answer, a line.

    Raises:
        DeviceError: There is no answer within the limit.
    """
    until_s = time.monotonic() + limit_s
    try:
        with socket.create_connection((host, DASHBOARD_PORT), limit_s) as connection:
            connection.sendall(command.encode() + b"\n")  # it need not wait for the greeting
            _, rest = _line(connection, b"", until_s)
            answer, _ = _line(connection, rest, until_s)
    except OSError as error:
        raise DeviceError(
            f"the dashboard at {host}:{DASHBOARD_PORT} does not take {command!r}: {error}"
        ) from error
    return answer


def require_controller(host: str, limit_s: float) -> None:
    """Check that every port that the driver uses answers.

    ur_rtde waits for a controller that accepts connections and then says nothing, with the whole
    interpreter stopped meanwhile. So it is asked first, within a limit.

    Raises:
        DeviceError: A port does not answer within the limit.
    """
    port = RTDE_PORT
    try:
        with socket.create_connection((host, port), limit_s) as connection:
            connection.settimeout(limit_s)
            connection.sendall(ASK_PROTOCOL_2)
            if not connection.recv(1):
                raise ConnectionResetError("it hung up")
        port = SCRIPT_PORT
        socket.create_connection((host, port), limit_s).close()
        port = DASHBOARD_PORT
        with socket.create_connection((host, port), limit_s) as connection:
            _line(connection, b"", time.monotonic() + limit_s)
    except OSError as error:
        raise DeviceError(
            f"no UR controller answers at {host}:{port}: {error}; "
            "check address, power and that remote control is on"
        ) from error


def _line(connection: socket.socket, rest: bytes, until_s: float) -> tuple[str, bytes]:
    """Return the next line and what came after it."""
    while b"\n" not in rest:
        left_s = until_s - time.monotonic()
        if left_s <= 0.0 or len(rest) > LONGEST_LINE:
            raise TimeoutError("no whole line came in time")
        connection.settimeout(left_s)
        data = connection.recv(1024)
        if not data:
            raise ConnectionResetError("it hung up")
        rest += data
    line, _, rest = rest.partition(b"\n")
    return line.decode(errors="replace").strip(), rest


# Program that makes the controller stop the arm as on a limit of force.
PROTECT = "def spikingtac_protect():\n  protective_stop()\nend\n"


@dataclass(frozen=True, kw_only=True)
class StopLink:
    """What a stop needs of one controller.

    Attributes:
        host: Its address.
        by_control_script: Gives the control script a stop; returns False where there is none.
        hush: Ends the heartbeat, so that the controller's own watchdog stops the arm, too.
        report: Returns the arm's last report.
        limit_s: Longest wait for a port, s.
    """

    host: str
    by_control_script: Callable[[], bool]
    hush: Callable[[], None]
    report: Callable[[], Report]
    limit_s: float


def verified_stop(
    link: StopLink, config: StopConfig, power_off: bool, clock_s: Callable[[], float]
) -> VerifiedStop:
    """Return what stops the arm of one controller.

    ``stopl`` in the control script; a program on the script port, which ends whatever program runs;
    a protective stop, and the dashboard's ``stop``, since the dashboard has no command for a
    protective one; at last, where the arm is seen to move, its power is switched off.

    Args:
        link: The controller.
        config: When the arm counts as stopped.
        power_off: Whether the last resort is used.
        clock_s: A monotonic clock, s.
    """
    host, limit_s = link.host, link.limit_s
    brake = f"def spikingtac_stop():\n  stopl({config.deceleration_m_s2})\nend\n"

    def gently() -> None:
        if not link.by_control_script():
            send_script(host, brake, limit_s)

    def by_own_script() -> None:
        link.hush()
        send_script(host, brake, limit_s)

    def by_protective_stop() -> None:
        send_script(host, PROTECT, limit_s)
        dashboard(host, "stop", limit_s)

    return VerifiedStop(
        (
            Means("a stop", gently),
            Means("a stop script", by_own_script),
            Means("a protective stop", by_protective_stop),
        ),
        link.report,
        config,
        Means("power off", lambda: dashboard(host, "power off", limit_s)) if power_off else None,
        clock_s,
    )
