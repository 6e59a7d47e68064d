"""The contact path in a process of its own, so that no other work delays it."""

from __future__ import annotations

import json
import multiprocessing
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from spikingtac.contact.detector import ContactDetector
from spikingtac.errors import DeviceError
from spikingtac.live.contact_loop import Arrival, ContactLoop, GuardReport, Subscriber
from spikingtac.live.factory import Factory
from spikingtac.live.ring import SharedRing
from spikingtac.live.stream_clock import StreamClock
from spikingtac.robot.arm import Arm, ArmState
from spikingtac.robot.watchdog import Health, Watchdog, WatchdogConfig, WatchdogThread

STATUS_BYTES = 1 << 14
LONGEST_REASON = 1_000
"""Characters of a reason that are told; JSON needs at most 12 bytes for each."""
STATUS_PERIOD_S = 0.02
"""Period at which the guard checks controller and parent, and publishes its status."""
CUT_MARK = "... (cut)"
"""End of a reason that was too long for the status."""
LEARNED_WINDOWS = 50
"""Windows before the guard arms: one of them at least arrives without delay (ours)."""
CATCH_UP_S = 10.0
"""Longest time that a stream may take to catch up with its sensor after it was opened, s (ours)."""
SHUTDOWN_S = 5.0


class ContactProcess:
    """Guards an arm in another process from its start until a contact or a fault.

    Args:
        arrivals: Opens the stream of windows, in the process: a camera is opened there.
        detector: Makes the detector.
        arm: Makes the arm's driver: the stop command passes through no other process.
        watchdog: When the stream counts as lost.
        recorder: A bounded queue of processes; windows that it does not take are counted.
    """

    def __init__(
        self,
        arrivals: Factory[Iterator[Arrival]],
        detector: Factory[ContactDetector],
        arm: Factory[Arm],
        watchdog: WatchdogConfig | None = None,
        recorder: Any = None,
    ) -> None:
        context = multiprocessing.get_context("spawn")
        self._ring = SharedRing.create(STATUS_BYTES)
        self._seen = 0
        self._last: dict[str, Any] = {}
        work = (arrivals, detector, arm, watchdog or WatchdogConfig(), recorder, self._ring.name)
        self._process = context.Process(target=_guard, args=work, daemon=True, name="contact")
        self._process.start()

    def status(self) -> dict[str, Any]:
        """Return the latest state without waiting; empty before the first.

        ``phase`` is ``ready`` (the self-test has passed, the guard watches), ``tripped`` (the arm
        was commanded to stop, the loop may hang), ``ended`` or ``failed``; ``reason`` says why.
        The rest are the fields of :class:`GuardReport`, and ``at_s`` on the monotonic clock.
        """
        found = self._ring.latest(self._seen)
        if found is not None:
            self._seen, message = found
            self._last = json.loads(message)
        return self._last

    def alive(self) -> bool:
        """Return whether the process runs."""
        return self._process.is_alive()

    def kill(self) -> None:
        """End the process at once; the robot's own watchdog then has to stop the arm."""
        self._process.kill()
        self._process.join(SHUTDOWN_S)

    def close(self) -> None:
        """End the process, if it still runs, and release the shared memory."""
        self._process.terminate()
        self._process.join(SHUTDOWN_S)
        self._ring.close()


class GuardStatus:
    """Publishes the guard's state, and checks regularly that controller and parent are there.

    Args:
        ring: Where the parent reads the state; its slots hold :data:`STATUS_BYTES`.
    """

    def __init__(self, ring: SharedRing) -> None:
        self._ring = ring
        self._lock = threading.Lock()  # the watchdog's thread publishes too
        self._fields: dict[str, Any] = {}
        self._due_s = 0.0
        self._parent = multiprocessing.parent_process()

    def check(self, loop: ContactLoop, arm: Arm, watchdog: Watchdog) -> None:
        """Look at controller and parent and publish, once in a period; to be called per window."""
        if time.monotonic() < self._due_s:
            return
        self._due_s = time.monotonic() + STATUS_PERIOD_S
        if self._parent is not None and not self._parent.is_alive():
            watchdog.disconnected("the process that asked for the guard is gone")
        state = arm.state()
        if state in (ArmState.PROTECTIVE_STOP, ArmState.DISCONNECTED):
            watchdog.disconnected(f"the arm's controller: {state.value}")
        if watchdog.health is Health.OK:
            self.publish("ready", loop.report())

    def tripped(self, watchdog: Watchdog) -> None:
        """Publish a trip from whichever thread it happens in: the loop itself may hang."""
        reason, failure = watchdog.reason, watchdog.stop_failure
        if failure is not None:
            reason += f"; the stop failed: {type(failure).__name__}: {failure}"
        health = {"health": watchdog.health.value}
        self._publish({**self._fields, **health, "phase": "tripped", "reason": reason})

    def publish(self, phase: str, report: GuardReport | None = None, reason: str = "") -> None:
        """Publish a phase with the loop's report; ``reason`` stands before the report's own."""
        if report is not None:
            self._fields = asdict(report) | {"health": report.health.value}
        reason = reason or (report.reason if report is not None else "")
        self._publish({**self._fields, "phase": phase, "reason": reason})

    def _publish(self, state: dict[str, Any]) -> None:
        with self._lock:
            self._ring.publish(status_message({**state, "at_s": time.monotonic()}))


def status_message(state: dict[str, Any]) -> bytes:
    """Return a state as JSON that fits into the ring; a long ``reason`` is cut."""
    reason = state["reason"]
    if len(reason) > LONGEST_REASON:
        state = {**state, "reason": reason[:LONGEST_REASON] + CUT_MARK}
    return json.dumps(state).encode()


def _guard(
    arrivals: Factory[Iterator[Arrival]],
    make_detector: Factory[ContactDetector],
    make_arm: Factory[Arm],
    config: WatchdogConfig,
    recorder: Any,
    ring_name: str,
) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when to stop
    status = GuardStatus(SharedRing.attach(ring_name, STATUS_BYTES))
    try:
        detector, arm = make_detector(), make_arm()
    except Exception as error:  # the parent has no other way to learn of it
        status.publish("failed", reason=f"{type(error).__name__}: {error}")
        return
    subscribers = [] if recorder is None else [Subscriber(recorder)]
    watchdog = Watchdog(config, arm.stop, time.monotonic, lambda: status.tripped(watchdog))
    clock = StreamClock()
    loop = ContactLoop(detector, watchdog, arm.stop, subscribers, stream_clock=clock)
    try:
        watchdog.self_test()  # a stop takes longer than the allowed silence, so it comes first
        stream = arrivals()
        catch_up(stream, detector, clock, config.backlog_s)
        watchdog.arm()
        with WatchdogThread(watchdog):
            report = loop.guard(stream, lambda loop: status.check(loop, arm, watchdog))
        status.publish("ended", report)
    except BaseException as error:
        watchdog.disconnected(f"{type(error).__name__}: {error}")
        status.publish("failed", loop.report())
        raise
    finally:
        if recorder is not None:
            recorder.cancel_join_thread()  # a recorder that hangs must not keep the process


def catch_up(
    stream: Iterator[Arrival], detector: ContactDetector, clock: StreamClock, backlog_s: float
) -> None:
    """Read on until a stream is at its pace; what piled up while it was opened is dropped.

    Args:
        stream: Just opened.
        detector: Gets the first window, which compiles its kernels, and is reset.
        clock: Learns how sensor time maps to host time.
        backlog_s: The stream is at its pace where it lags less than half of this.

    Raises:
        DeviceError: The stream ended, or it stays behind.
    """
    until_s = float("inf")
    for count, arrival in enumerate(stream, 1):
        clock.arrive(arrival.end_us, arrival.received_s)
        behind_s = clock.backlog_s(arrival.end_us, arrival.received_s)
        if count == 1:
            detector.update(arrival.window)
            detector.reset()
            until_s = arrival.received_s + CATCH_UP_S
        elif count >= LEARNED_WINDOWS and behind_s < backlog_s / 2.0:
            return
        if arrival.received_s > until_s:
            raise DeviceError(
                f"the event stream stays {behind_s * 1e3:.0f} ms behind; "
                "give the machine less other work, or lower the sensor's event rate"
            )
    raise DeviceError("the event stream ended before the guard was ready")
