"""The contact path in a process of its own, so that no other work delays it."""

import json
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from spikingtac.contact.detector import ContactDetector
from spikingtac.errors import DeviceError, SpikingTacError
from spikingtac.robot.arm import Arm, ArmState
from spikingtac.robot.guard_loop import (
    LONGEST_REASON,
    Arrival,
    ContactLoop,
    catch_up,
    failure_words,
)
from spikingtac.robot.watchdog import Health, Watchdog, WatchdogThread
from spikingtac.stream import real_time
from spikingtac.stream.host import Asker, Host
from spikingtac.stream.ring import RingReader, SharedRing

RING_BYTES = 1 << 16  # Room for states: for some of those with the longest reason.

# Period at which the guard checks controller and parent, and publishes its status.
STATUS_PERIOD_S = 0.02
SHUTDOWN_S = 5.0

# Longest silence of a stream that the guard still catches up with, beyond the watchdog's own, s.
CATCHING_UP_S = 1.0

# Time for which a guard that has to end stops an arm that moves on again and again; less than
# :data:`SHUTDOWN_S`, after which its parent ends it.
INSISTENCE_S = 4.0

# Pause between these stops: one that fails at once, since the controller is gone, would keep a
# core from everything else, another arm's guard included.
INSISTENCE_PERIOD_S = 0.002


class ContactProcess(Host):
    """Guards an arm in another process from its start until a contact or a fault.

    Each argument travels to the process: a function of a module, or a partial of one.

    Args:
        arrivals: Opens the stream of windows, in the process: a camera is opened there.
        detector: Makes the detector.
        arm: Makes the arm's driver: the stop command passes through no other process.
        watchdog: Makes the watchdog; a partial of it sets when the stream counts as lost.

    Closing lets the process stop the arm; after :meth:`kill` the robot's own watchdog has to.
    """

    patience_s = SHUTDOWN_S

    def __init__(
        self,
        arrivals: Callable[[], Iterator[Arrival]],
        detector: Callable[[], ContactDetector],
        arm: Callable[[], Arm],
        watchdog: Callable[..., Watchdog] = Watchdog,
    ) -> None:
        made = {"make_detector": detector, "make_arm": arm, "make_watchdog": watchdog}
        super().__init__("the guard", partial(_guard, arrivals=arrivals, **made), RING_BYTES)
        self._states, self._last = RingReader(self.rings[0]), dict[str, Any]()

    def status(self) -> dict[str, Any]:
        """Return the latest state without waiting; empty before the first.

        ``phase`` is ``starting`` (``reason`` says what is waited for), ``ready`` (the self-test has
        passed, the guard watches), ``tripped`` (the arm was commanded to stop, the loop may hang),
        ``ended`` or ``failed``; ``reason`` says why, and ``stop_failure`` whether the arm is not
        known to rest. ``connected`` says whether an arm was reached; ``code`` of a guard that
        failed before is the exit code of its error, if it has one. ``precedes`` says whether the
        system lets the guard run before ordinary work; a busy machine may trip one that does not.
        The rest is :meth:`~spikingtac.robot.guard_loop.ContactLoop.report`, and ``at_s`` on the
        monotonic clock.
        """
        if (message := self._states.latest()) is not None:
            self._last = json.loads(message)
        return self._last


class GuardStatus:
    """Publishes the guard's state, and checks regularly that controller and asker are there.

    Args:
        ring: Where the asker reads the state; of :data:`RING_BYTES`.
        asker_gone: Set once the process that asked for the guard has ended.
    """

    def __init__(self, ring: SharedRing, asker_gone: threading.Event) -> None:
        self._ring, self._asker_gone = ring, asker_gone
        self._lock = threading.Lock()  # the watchdog's thread publishes too
        self._fields: dict[str, Any] = {"connected": False, "precedes": False}
        self._due_s = 0.0

    def check(self, loop: ContactLoop, arm: Arm, watchdog: Watchdog) -> None:
        """Look at controller and asker and publish, once in a period; to be called per window."""
        if time.monotonic() < self._due_s or watchdog.health is not Health.OK:
            return
        self._due_s = time.monotonic() + STATUS_PERIOD_S
        if self._asker_gone.is_set():
            watchdog.disconnected("the process that asked for the guard is gone")
        state = arm.state()
        if state in (ArmState.PROTECTIVE_STOP, ArmState.DISCONNECTED):
            watchdog.disconnected(f"the arm's controller: {state.value}")
        if watchdog.health is Health.OK:
            self.publish("ready", **loop.report())

    def tripped(self, watchdog: Watchdog) -> None:
        """Publish a trip from whichever thread it happens in: the loop itself may hang."""
        reason, failure = watchdog.reason, failure_words(watchdog.stop_failure)
        if failure:
            reason += f"; the stop failed: {failure}"
        self.publish("tripped", reason=reason, health=watchdog.health.value, stop_failure=failure)

    def publish(self, phase: str, reason: str = "", **fields: Any) -> None:
        """Publish a phase, why, and the fields so far; a long ``reason`` is cut."""
        with self._lock:
            if len(reason) > LONGEST_REASON:
                reason = reason[:LONGEST_REASON] + "... (cut)"
            self._fields |= {**fields, "phase": phase, "reason": reason, "at_s": time.monotonic()}
            self._ring.publish(json.dumps(self._fields).encode())


def _guard(
    asker: Asker,
    arrivals: Callable[[], Iterator[Arrival]],
    make_detector: Callable[[], ContactDetector],
    make_arm: Callable[[], Arm],
    make_watchdog: Callable[..., Watchdog],
) -> None:
    asker.grace_s = SHUTDOWN_S
    status = GuardStatus(asker.rings[0], asker.gone)
    try:
        detector = make_detector()
        status.publish("starting", reason="the camera's events")
        stream = arrivals()
        # The controller has to hear from this process all the time. What stops all threads comes
        # before: the first window, which compiles the detector's kernels or loads them, and a
        # garbage collection.
        if (first := next(stream, None)) is None:
            raise DeviceError("the event stream ended before the guard was ready")
        detector.update(first.packet)
        detector.reset()
        real_time.exempt_from_collection()
        real_time.lock_memory()
        status.publish("starting", reason="the arm")
        arm = make_arm()
    except Exception as error:  # the asker has no other way to learn of it
        kind = "" if isinstance(error, SpikingTacError) else f"{type(error).__name__}: "
        status.publish("failed", reason=f"{kind}{error}", code=getattr(error, "exit_code", None))
        return
    status.publish("starting", reason="the self-test", connected=True)
    _watch(status, stream, detector, arm, make_watchdog)


def _watch(
    status: GuardStatus,
    stream: Iterator[Arrival],
    detector: ContactDetector,
    arm: Arm,
    make_watchdog: Callable[..., Watchdog],
) -> None:
    """Test the stop, catch up with the stream, and guard the arm until a contact or a fault."""
    watchdog = make_watchdog(
        arm.stop, time.monotonic, lambda: status.tripped(watchdog), arm.confirm_stop
    )
    rests = _obey_sigterm(watchdog)
    loop = ContactLoop(detector, watchdog, arm.stop)
    try:
        watchdog.self_test()  # a stop takes longer than the allowed silence, so it comes first
        # What takes long the first time is done once before the watch begins.
        json.dumps([loop.report(), arm.state().value])
        # Threads of one interpreter gain nothing from a second core, and a stall of either would
        # hold up all of them: with precedence they keep to one.
        if precedes := real_time.take_precedence(real_time.GUARD_PRIORITY):
            real_time.keep_to_one_core()
        status.publish("starting", reason="the stream's pace", precedes=precedes)
        watchdog.arm(CATCHING_UP_S)  # a camera that stalls now is no longer waited for
        with WatchdogThread(watchdog):
            # Last: what piled up until here is no lag.
            loop.stream_clock = catch_up(stream, watchdog.backlog_s, watchdog.beat)
            watchdog.arm()
            loop.guard(stream, lambda loop: status.check(loop, arm, watchdog))
        if loop.contact is not None:
            try:
                arm.confirm_stop()
            except Exception as error:  # whatever the driver raises, the arm may move on
                watchdog.stop_failed(error)
        if watchdog.stop_failure is None:
            rests.set()
        status.publish("ended", **loop.report())
    except BaseException as error:
        watchdog.disconnected(f"{type(error).__name__}: {error}")
        status.publish("failed", **loop.report())
        raise


def _obey_sigterm(watchdog: Watchdog) -> threading.Event:
    """Brake on SIGTERM from now on, until the event that is returned says that the arm rests.

    The signal is heard through a socket, whichever thread it comes to, and while the main thread
    hangs. A mask would not do: libraries have begun threads of their own by now (OpenBLAS), which
    would take the signal and end the process with the arm in motion.
    """
    told, writable = socket.socketpair()
    writable.setblocking(False)
    signal.set_wakeup_fd(writable.detach(), warn_on_full_buffer=False)
    signal.signal(signal.SIGTERM, lambda number, frame: None)
    brake = (watchdog, told, rests := threading.Event())
    threading.Thread(target=_brake, args=brake, daemon=True).start()
    return rests


def _brake(watchdog: Watchdog, told: socket.socket, rests: threading.Event) -> None:
    """Stop the arm once SIGTERM came, then end the process, also where its loop hangs.

    Nothing is left to do where the guard has ended with its arm at rest.
    """
    while told.recv(1) != bytes([signal.SIGTERM]):
        pass
    if rests.is_set():
        return
    watchdog.disconnected(watchdog.reason or "the guard was told to end")
    until_s = time.monotonic() + INSISTENCE_S
    while watchdog.stop_failure is not None and time.monotonic() < until_s:
        time.sleep(INSISTENCE_PERIOD_S)
        watchdog.check()  # stops again, and waits for the outcome
    os._exit(0)
