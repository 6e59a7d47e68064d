"""A stop of a UR arm that is repeated, more firmly each time, until its own reports confirm it.

"Sent" is not "stopped": a controller may acknowledge a command and not brake. So the reported speed
is watched. Where it does not fall in time, the next means is used; where the last one has failed,
that is told at once. Not a safety function.

The open ports of the controller are spoken to within a limit of time, independently of ur_rtde and
of the program that runs there: dashboard server (29999) and script port (30002) take lines of text,
RTDE (30004) takes packages. Sources: "Dashboard server", "Remote control via TCP/IP" and "Real-time
data exchange guide", universal-robots.com.
"""

import socket
import struct
import threading
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

from spikingtac.errors import DeviceError

POLL_S = 0.002  # Time between two looks at the reported speed, s: a quarter of a cycle of CB3.

# Least share of the asked deceleration that counts as braking (jerk and servo lag).
BRAKING_SHARE = 0.5
SPEED_NOISE_MM_S = 2.0  # What a reported speed may rise by without a motion, mm/s.

# Reported speed below which the arm rests, mm/s (measured speeds of an arm at rest stay
# below 0.5).
REST_MM_S = 1.0

DASHBOARD_PORT = 29999
SCRIPT_PORT = 30002
RTDE_PORT = 30004

# RTDE package: length, type, version of the protocol that is asked for.
ASK_PROTOCOL_2 = struct.pack(">HBH", 5, ord("V"), 2)
LONGEST_LINE = 4096  # Bytes of the longest line that is taken for an answer.
# Longest wait for a command, s (60 cycles of CB3); then the controller counts as lost.
CALL_LIMIT_S = 0.5
DECELERATION_M_S2 = 8.0  # Deceleration that is asked for, m/s2 (contract.md).

# Rest counts once it is reported so long after the stop, s (two cycles of CB3, within which a
# motion that was commanded just before would begin).
CONFIRM_S = 0.02


class Means(NamedTuple):
    """One way to stop an arm.

    Attributes:
        name: For the report.
        use: Uses it; may raise and may take its time, since nobody waits for it.
        react_s: Time that it has until the speed must fall, s; 0 where nobody watches it.
    """

    name: str
    use: Callable[[], object]
    react_s: float = 0.0


class Report(NamedTuple):
    """The arm's last report.

    Attributes:
        seen_s: When it came, on the clock of the stop, s.
        speed_mm_s: Speed of the tool, mm/s.
    """

    seen_s: float
    speed_mm_s: float


class VerifiedStop:
    """Stops one arm, by one means after the other until it rests.

    Args:
        means: The gentlest first.
        report: Returns the arm's last report.
        last_resort: Used where an arm is seen to move after all means; not waited for.
        clock_s: A monotonic clock, s; that of the reports.

    Attributes:
        running: Whether a stop is being watched; a motion that begins now would be stopped.
    """

    def __init__(
        self,
        means: Sequence[Means],
        report: Callable[[], Report],
        last_resort: Means | None = None,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._means, self._last_resort = tuple(means), last_resort
        self._report, self._clock_s = report, clock_s
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._failure: str | None = None
        self._refusals: list[str] = []
        self.running = False

    def begin(self) -> None:
        """Begin to stop and return at once; a stop that is under way goes on."""
        with self._lock:
            if not self.running:
                self.running = True
                self._thread = threading.Thread(target=self._run, name="verified-stop", daemon=True)
                self._thread.start()

    def confirm(self) -> None:
        """Wait for the outcome of the last stop.

        Raises:
            DeviceError: The arm moves on, or nothing says that it rests.
        """
        thread = self._thread
        if thread is not None:
            thread.join()
        if self._failure is not None:
            raise DeviceError(self._failure)

    def _run(self) -> None:
        try:
            self._failure = self._outcome()
        except Exception as error:  # a broken client raises what it likes
            self._failure = f"the arm's reports cannot be read: {error}; press the emergency stop"
        finally:
            with self._lock:
                self.running = False

    def _outcome(self) -> str | None:
        """Use one means after the other; return what failed, or None."""
        self._refusals = []
        last: Report | None = None
        for means in self._means:
            begun_s = self._clock_s()
            self._use(means)
            rests, last = self._watch(begun_s, means.react_s)
            if rests:
                return None
        told = "nothing is heard of the arm, so that nobody knows whether it rests"
        if last is not None:
            if self._last_resort is not None:
                self._use(self._last_resort)
            told = f"the arm still moves at {last.speed_mm_s:.0f} mm/s"
        names = ", ".join(means.name for means in self._means)
        return "; ".join([f"{told} after {names}", "press the emergency stop", *self._refusals])

    def _watch(self, begun_s: float, react_s: float) -> tuple[bool, Report | None]:
        """Watch one means; return whether the arm rests, and its last report since."""
        top_mm_s = 0.0
        latest: Report | None = None
        while True:
            now_s = self._clock_s()  # before the report: whoever is held up in between knows more
            report = self._report()
            if report.seen_s > begun_s:
                latest = report
                top_mm_s = max(top_mm_s, report.speed_mm_s)
                confirmed = report.seen_s - begun_s >= CONFIRM_S
                if confirmed and report.speed_mm_s <= REST_MM_S:
                    return True, latest
            if now_s - begun_s > react_s:
                # The largest speed with which an arm still counts as braking.
                braking_mm_s2 = BRAKING_SHARE * DECELERATION_M_S2 * 1e3
                braked_mm_s = braking_mm_s2 * (now_s - begun_s - react_s)
                allowed_mm_s = max(top_mm_s + SPEED_NOISE_MM_S - braked_mm_s, REST_MM_S)
                if latest is None or latest.speed_mm_s > allowed_mm_s:
                    return False, latest
                if now_s - latest.seen_s > react_s:  # the reports have ended meanwhile
                    return False, None
            time.sleep(POLL_S)

    def _use(self, means: Means) -> None:
        """Use a means without waiting for it."""

        def use() -> None:
            try:
                means.use()
            except Exception as error:  # the next means follows whatever this one raises
                self._refusals.append(f"{means.name}: {error}")

        threading.Thread(target=use, name=f"stop: {means.name}", daemon=True).start()


def send_script(host: str, script: str) -> None:
    """Send a URScript program; it replaces the one that runs.

    Raises:
        DeviceError: It could not be sent within :data:`CALL_LIMIT_S`.
    """
    try:
        with socket.create_connection((host, SCRIPT_PORT), CALL_LIMIT_S) as connection:
            connection.sendall(script.encode())
    except OSError as error:
        raise DeviceError(f"no script could be sent to {host}:{SCRIPT_PORT}: {error}") from error


def dashboard(host: str, command: str) -> str:
    """Give the dashboard server one command and return its answer, a line.

    Raises:
        DeviceError: There is no answer within :data:`CALL_LIMIT_S`.
    """
    try:
        with (
            socket.create_connection((host, DASHBOARD_PORT), CALL_LIMIT_S) as connection,
            connection.makefile("r", errors="replace") as lines,
        ):
            connection.sendall(command.encode() + b"\n")  # it need not wait for the greeting
            lines.readline(LONGEST_LINE)
            answer = lines.readline(LONGEST_LINE)
            if not answer.endswith("\n"):
                raise ConnectionResetError("it hung up, or sends no line")
    except OSError as error:
        raise DeviceError(
            f"the dashboard at {host}:{DASHBOARD_PORT} does not take {command!r}: {error}"
        ) from error
    return answer.strip()


def require_controller(host: str, limit_s: float) -> None:
    """Check that every port that the driver uses answers.

    ur_rtde waits for a controller that accepts connections and then says nothing, with the whole
    interpreter stopped meanwhile. So it is asked first, within a limit.

    Raises:
        DeviceError: A port does not answer within the limit.
    """
    # The script port says nothing of use; the dashboard greets.
    for port, question in ((RTDE_PORT, ASK_PROTOCOL_2), (SCRIPT_PORT, None), (DASHBOARD_PORT, b"")):
        try:
            with socket.create_connection((host, port), limit_s) as connection:
                connection.sendall(question or b"")
                if question is not None and not connection.recv(1):
                    raise ConnectionResetError("it hung up")
        except OSError as error:
            raise DeviceError(
                f"no UR controller answers at {host}:{port}: {error}; "
                "check address, power and that remote control is on"
            ) from error
