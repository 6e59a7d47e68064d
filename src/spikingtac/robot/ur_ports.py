"""The open ports of a UR controller, each spoken to within a limit of time.

Dashboard server (29999) and script port (30002) take lines of text; RTDE (30004) takes packages.
They are independent of ur_rtde and of the program that runs on the controller. Sources: "Dashboard
server", "Remote control via TCP/IP" and "Real-time data exchange guide", universal-robots.com.
"""

from __future__ import annotations

import socket
import struct
import time

from spikingtac.errors import DeviceError

DASHBOARD_PORT = 29999
SCRIPT_PORT = 30002
RTDE_PORT = 30004
ASK_PROTOCOL_2 = struct.pack(">HBH", 5, ord("V"), 2)
"""RTDE package: length, type, version of the protocol that is asked for."""
LONGEST_LINE = 4096
"""Bytes of the longest line that is taken for an answer."""


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
