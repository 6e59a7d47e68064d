"""ur_rtde's native client: how it is connected and let go of, and calls into it that may hang.

A client that waits for a silent controller cannot be interrupted. What can be done is not to wait
for it, to start nothing else in it, and to know for how long it has hung.
"""

import contextlib
import ctypes
import os
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import Any

from spikingtac.errors import DeviceError, import_extra
from spikingtac.robot.ur_stop import require_controller

# Longest time for which a call runs with real-time priority, s (two cycles of CB3 and some;
# a controller that answers does so within them).
SPIN_S = 0.02


def step_back() -> None:
    """Let this process's main thread run before this one, where that has real-time priority.

    A native client may wait for its controller without letting go of the core (ur_rtde: up to 3 s);
    with equal priority nothing else of the process would run there meanwhile, its watchdog neither.
    """
    with contextlib.suppress(AttributeError, OSError):  # another system than Linux
        main = os.getpid()  # the id of the main thread
        highest = os.sched_getparam(main).sched_priority - 1
        if os.sched_getscheduler(main) == os.SCHED_FIFO and highest >= 1:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(highest))


def step_down(thread: int = 0) -> None:
    """Make a thread of this process, given by its native id, ordinary work; 0 is this one.

    Among equals nobody lets go of the core either: the calls of another guard, for another arm, run
    with the same priority, and its controller would miss its heartbeat.
    """
    with contextlib.suppress(AttributeError, OSError):  # another system, or the thread has ended
        if os.sched_getscheduler(thread) == os.SCHED_FIFO:
            os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))


class BoundedCalls:
    """Runs calls in the order in which they come, each waited for within its own limit.

    Args:
        name: What is called, for messages and for the thread.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._calls: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None]
        self._calls = queue.SimpleQueue()
        self._begun_s: float | None = None
        self._turn = threading.Lock()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def call(
        self,
        command: Callable[[], Any],
        limit_s: float,
        late: Callable[[], None] = lambda: None,
    ) -> Any:
        """Return what the command returns.

        Args:
            command: Called in the thread, unless the limit has passed before its turn.
            limit_s: Longest wait, for the turn and for the command together, s.
            late: Called in the thread if the command returns after it was given up.

        Raises:
            DeviceError: The command raised an error, or did not return in time.
        """
        until_s = time.monotonic() + limit_s
        if not self._turn.acquire(timeout=max(limit_s, 0.0)):
            raise DeviceError(f"{self._name}: an earlier call has not returned within {limit_s} s")
        call: Future[Any] = Future()
        try:
            self._calls.put((call, command))
            done, _ = wait([call], min(SPIN_S, max(until_s - time.monotonic(), 0.0)))
            if not done:
                step_down(self._thread.native_id or 0)  # ordinary work from now on
            return call.result(max(until_s - time.monotonic(), 0.0))
        except TimeoutError as error:
            if not (call.cancel() or call.done()):
                call.add_done_callback(lambda _: late())
            raise DeviceError(f"{self._name}: no answer within {limit_s} s") from error
        except Exception as error:  # a native client raises what it likes
            raise DeviceError(f"{self._name}: {error}") from error
        finally:
            self._turn.release()

    def running_s(self) -> float:
        """Return for how long the present call has run, s; 0 without one."""
        begun_s = self._begun_s
        return 0.0 if begun_s is None else time.monotonic() - begun_s

    def end(self, limit_s: float) -> bool:
        """Take no further calls, wait for the present one, and return whether it has returned."""
        self._calls.put(None)
        self._thread.join(limit_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (given := self._calls.get()) is not None:
            call, command = given
            if not call.set_running_or_notify_cancel():  # given up before its turn
                continue
            step_back()
            self._begun_s = time.monotonic()
            try:
                result, error = command(), None
            except Exception as raised:
                result, error = None, raised
            self._begun_s = None
            if error is None:
                call.set_result(result)
            else:
                call.set_exception(error)


# What is asked of the controller: enough for the protocol, little enough for CB3 at 125 Hz.
RECEIVED = [
    "timestamp", "actual_TCP_pose", "actual_TCP_speed", "target_TCP_speed", "robot_status_bits",
    "safety_status_bits", "runtime_state",
]  # fmt: skip


# Longest wait for an interface to disconnect, or for its last call, s (ur_rtde's own take half a
# second each; a call on a silent controller returns after 2.8).
DISCONNECT_S = 3.0


def connect(host: str, limit_s: float) -> tuple[Any, Any]:
    """Return ur_rtde's receive and control interfaces.

    Args:
        host: Address of the controller.
        limit_s: Longest wait for the first answer of each port, s.

    Raises:
        MissingExtraError: ur_rtde is not installed.
        DeviceError: The controller does not answer, or refuses.
    """
    rtde_control = import_extra("rtde_control", "the driver of UR arms", "robot")
    rtde_receive = import_extra("rtde_receive", "the driver of UR arms", "robot")
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

    def run() -> None:
        step_down()  # it may wait without letting go of the core
        with contextlib.suppress(Exception):  # whatever a broken native client raises
            interface.disconnect()

    if not hangs:
        thread = threading.Thread(target=run, name="ur-disconnect", daemon=True)
        thread.start()
        thread.join(DISCONNECT_S)
        hangs = thread.is_alive()
    if hangs:  # freed, it would wait for its own threads, and the interpreter with it
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(interface))
