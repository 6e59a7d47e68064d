"""A controller of a UR that speaks its protocols on loopback and moves as the twin does.

RTDE (30004), URScript (30001 to 30003) and dashboard (29999) listen on one loopback address of
their own. The part of the control script that ur_rtde uploads is played here: a command register
in, a state register out (1 ready, 2 done). Faults are injected by its methods.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
import struct
import threading
import time
from collections.abc import Callable

import numpy as np

from spikingtac.robot.arm import ArmState
from spikingtac.sim.rig.ur3 import UR3Twin
from stand_ins.rtde_wire import HEADER, Recipe, frame, recipe_of

RTDE_PORT, DASHBOARD_PORT, SCRIPT_PORTS = 30004, 29999, (30001, 30002, 30003)
READY, DONE = 1, 2
NO_CMD, MOVE_L, STOP_SCRIPT, STOP_L, SET_WATCHDOG = 0, 3, 255, 33, 35
POWER_ON, PROGRAM_RUNNING = 1, 2
NORMAL_MODE, PROTECTIVE_STOPPED = 1, 4

# Means to stop that a controller can be deaf to: it acknowledges them, and moves on.
STOPL, SCRIPT, PROTECTIVE, DASHBOARD, WATCHDOG, POWER = (
    "stopl", "stop script", "protective stop", "dashboard stop", "watchdog", "power off",
)  # fmt: skip
EVERYTHING = frozenset((STOPL, SCRIPT, PROTECTIVE, DASHBOARD, WATCHDOG, POWER))
ROTATION_VECTOR = (0.0, np.pi, 0.0)
START_MM = np.array([100.0, 200.0, 300.0])
_addresses = itertools.count()


class URController(contextlib.AbstractContextManager["URController"]):
    """One controller on a loopback address of its own (in 127.0.0.0/8).

    Args:
        e_series: Version 5 at 500 Hz, otherwise CB3 at 125 Hz.
    """

    def __init__(self, e_series: bool = False) -> None:
        process = os.getpid()  # its own addresses, so that two test runs do not meet
        self.host = f"127.{1 + process // 256 % 254}.{process % 256}.{2 + next(_addresses) % 250}"
        cycle_s = 0.002 if e_series else 0.008
        self.version = (5, 12, 0, 1) if e_series else (3, 15, 8, 106339)
        self.scripts: list[str] = []
        self.stalled = self.half_open = self.swallowed = False
        self.deaf_to: frozenset[str] = frozenset()
        self.dashboard_commands: list[str] = []
        self.asked_rates_hz: list[float] = []
        prompt = type("PromptTwin", (UR3Twin,), {"NETWORK_S": 0.0, "CYCLE_S": cycle_s})
        self.twin = prompt(START_MM, np.random.default_rng(1), repeatability_mm=0.0)
        self.stop_times_s: list[float] = []
        self._origin_s = time.monotonic() - 1.0
        self._lock = threading.RLock()
        self._registers: dict[str, object] = {}
        self._program, self._state = False, 0
        self._watchdog_s: float | None = None
        self._heard_s = time.monotonic()
        self._open = True
        self._sockets: list[socket.socket] = []
        self._listeners: list[socket.socket] = []
        self._accepting: list[threading.Thread] = []
        self._threads: list[threading.Thread] = []
        self._ended = threading.Event()
        self._in_background(self._tick)
        self._start_listening()

    def __exit__(self, *exception: object) -> None:
        self.shut_down()
        self._ended.set()
        for thread in self._threads:
            thread.join(5.0)

    def shut_down(self) -> None:
        """Close every port and connection, as when the power goes."""
        self._open = False
        for listener in self._listeners:
            _close(listener)
        for accepting in self._accepting:  # a connection may have come in meanwhile
            accepting.join(5.0)
        self._listeners, self._accepting = [], []
        for connection in self._sockets:
            _close(connection)
        self._sockets = []

    def start_again(self) -> None:
        """Listen again after :meth:`shut_down`."""
        self._open, self._program, self._state = True, False, 0
        self._start_listening()

    def protective_stop(self) -> None:
        """Stop as on a limit of force."""
        with self._lock:
            self._advance()
            self.twin.protective_stop()
            self._program = False

    def recover(self) -> None:
        """Clear a protective stop, as at the teach pendant."""
        with self._lock:
            self._advance()
            self.twin.recover()

    def _stop_unless_deaf(self, means: str, stop: Callable[[], None]) -> None:
        """Stop the arm, and the program unless it stops itself; or acknowledge, and go on."""
        if means not in self.deaf_to:
            self._advance()
            self.stop_times_s.append(time.monotonic())
            stop()
            self._program = self._program and means == STOPL

    def _start_listening(self) -> None:
        serve = {RTDE_PORT: self._serve_rtde, DASHBOARD_PORT: self._serve_dashboard}
        serve |= dict.fromkeys(SCRIPT_PORTS, self._serve_script)
        for port, session in serve.items():
            listener = socket.create_server((self.host, port))
            self._listeners.append(listener)
            self._accepting.append(self._in_background(self._accept, listener, session))

    def _accept(self, listener: socket.socket, session: Callable[[socket.socket], None]) -> None:
        with contextlib.suppress(OSError):
            while self._open:
                connection, _ = listener.accept()
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._sockets.append(connection)
                self._in_background(_quietly, session, connection)

    def _in_background(self, work: Callable[..., None], *arguments: object) -> threading.Thread:
        thread = threading.Thread(target=work, args=arguments, daemon=True)
        self._threads.append(thread)
        thread.start()
        return thread

    def _tick(self) -> None:
        """Live on without any client: move, and obey the watchdog."""
        while not self._ended.wait(0.004):
            with self._lock:
                self._advance()
                self._obey_watchdog()

    def _advance(self) -> None:
        self.twin.advance_to(round((time.monotonic() - self._origin_s) * 1e6))

    def _serve_script(self, connection: socket.socket) -> None:
        text = ""
        while data := connection.recv(65536):
            if self.half_open:
                continue
            text += data.decode(errors="replace")
            if text.rstrip().endswith("end") or text.endswith("\n\n"):
                self.scripts.append(text)
                self._play(text.split("\n")[1])
                text = ""

    def _play(self, first_line: str) -> None:
        """Play a program that was sent; it replaces the one that runs."""
        with self._lock:
            if "stopl" in first_line:
                self._stop_unless_deaf(SCRIPT, self.twin.stop)
            elif "protective_stop()" in first_line:
                self._stop_unless_deaf(PROTECTIVE, self.twin.protective_stop)
            else:
                self._program, self._state, self._watchdog_s = True, READY, None

    def _serve_dashboard(self, connection: socket.socket) -> None:
        if not self.half_open:
            connection.sendall(b"Connected: Universal Robots Dashboard Server\n")
        version = ".".join(map(str, self.version))
        answers = {
            "PolyscopeVersion": f"URSoftware {version} (Jan 01 2024)",
            "is in remote control": "true",
            "get serial number": "2024000001",
            "stop": "Stopped",
            "power off": "Powering off",
            "unlock protective stop": "Protective stop releasing",
        }
        for line in connection.makefile():  # closed with its connection
            command = line.strip()
            if self.half_open:
                continue
            self.dashboard_commands.append(command)
            reply = answers.get(command, "could not understand: " + command)
            with self._lock:
                self._command(command)
            connection.sendall((reply + "\n").encode())

    def _command(self, command: str) -> None:
        """Obey a command of the dashboard."""
        if command == "stop":
            self._stop_unless_deaf(DASHBOARD, self.twin.stop)
        if command == "power off":
            self._stop_unless_deaf(POWER, self.twin.protective_stop)
        if command == "unlock protective stop":
            self.twin.recover()

    def _serve_rtde(self, connection: socket.socket) -> None:
        stream = connection.makefile("rb")
        inputs: list[Recipe] = []
        outputs: list[tuple[Recipe, float]] = []
        while header := stream.read(HEADER.size):
            size, letter = HEADER.unpack(header)
            payload, letter = stream.read(size - HEADER.size), chr(letter)
            if self.half_open:
                continue
            if letter in "VSP":
                connection.sendall(frame(letter, b"\x01"))
            if letter == "v":
                connection.sendall(frame("v", struct.pack(">4I", *self.version)))
            elif letter == "O":
                (rate_hz,), recipe = (
                    struct.unpack(">d", payload[:8]),
                    recipe_of(payload[8:].decode()),
                )
                outputs.append((recipe, rate_hz))
                self.asked_rates_hz.append(rate_hz)
                connection.sendall(frame("O", b"\x01" + ",".join(recipe.kinds).encode()))
            elif letter == "I":
                inputs.append(recipe_of(payload.decode()))
                reply = bytes([len(inputs)]) + ",".join(inputs[-1].kinds).encode()
                connection.sendall(frame("I", reply))
            elif letter == "S":
                self._in_background(_quietly, self._stream, connection, outputs[-1])
            elif letter == "U":
                self._take(inputs[payload[0] - 1].unpack(payload[1:]))

    def _stream(self, connection: socket.socket, output: tuple[Recipe, float]) -> None:
        recipe, rate_hz = output
        due_s = time.monotonic()
        while self._open:
            if not (self.stalled or self.half_open):
                connection.sendall(frame("U", b"\x01" + recipe.pack(self._outputs())))
            due_s += 1.0 / rate_hz
            time.sleep(max(due_s - time.monotonic(), 0.0))

    def _outputs(self) -> dict[str, object]:
        with self._lock:
            self._advance()
            pose = (*(self.twin.true_position_mm() * 1e-3), *ROTATION_VECTOR)
            speed = (*(self.twin.speed_mm_s() * 1e-3), 0.0, 0.0, 0.0)
            stopped = self.twin.state() is ArmState.PROTECTIVE_STOP
            return {
                "timestamp": time.monotonic() - self._origin_s,
                "actual_TCP_pose": pose,
                "target_TCP_pose": pose,
                "actual_TCP_speed": speed,
                "target_TCP_speed": speed,
                "robot_status_bits": POWER_ON | (PROGRAM_RUNNING if self._program else 0),
                "safety_status_bits": PROTECTIVE_STOPPED if stopped else NORMAL_MODE,
                "safety_mode": 3 if stopped else 1,
                "robot_mode": 7,
                "runtime_state": 2 if self._program else 1,
                "speed_scaling": 1.0,
                "output_int_register_0": self._state if self._program else 0,
            }

    def _take(self, registers: dict[str, object]) -> None:
        with self._lock:
            self._advance()
            self._heard_s = time.monotonic()
            self._registers |= registers
            if self.swallowed:
                return
            command = self._registers.get("input_int_register_0", NO_CMD)
            if command == NO_CMD:
                self._state = READY
            elif self._state == READY and self._program:
                self._obey(int(command))  # type: ignore[call-overload]
                self._state = DONE

    def _obey(self, command: int) -> None:
        value = [float(self._registers.get(f"input_double_register_{k}", 0.0)) for k in range(8)]  # type: ignore[arg-type]
        if command == MOVE_L:
            if self.twin.state() is ArmState.IDLE:
                self.twin.move_linear(np.array(value[:3]) * 1e3, value[6] * 1e3)
        elif command == STOP_L:
            self._stop_unless_deaf(STOPL, self.twin.stop)
        elif command == SET_WATCHDOG:
            self._watchdog_s = 1.0 / value[0]
        elif command == STOP_SCRIPT:
            self._program, self._watchdog_s = False, None  # it is the program's own

    def _obey_watchdog(self) -> None:
        limit_s = self._watchdog_s
        if limit_s is not None and time.monotonic() - self._heard_s > limit_s:
            self._watchdog_s = None
            self._stop_unless_deaf(WATCHDOG, self.twin.protective_stop)


def _quietly(session: Callable[..., None], *arguments: object) -> None:
    """Run a session until its connection ends, which is no error."""
    with contextlib.suppress(OSError, ValueError, struct.error):
        session(*arguments)


def _close(connection: socket.socket) -> None:
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)
    connection.close()
