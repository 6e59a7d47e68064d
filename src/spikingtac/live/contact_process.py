"""The contact path in a process of its own, so that no other work delays it."""

from __future__ import annotations

import json
import multiprocessing
import signal
import time
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from spikingtac.contact.detector import ContactDetector
from spikingtac.live.contact_loop import Arrival, ContactLoop, GuardReport, Subscriber
from spikingtac.live.factory import Factory
from spikingtac.live.ring import SharedRing
from spikingtac.robot.arm import Arm, ArmState
from spikingtac.robot.watchdog import Watchdog, WatchdogConfig, WatchdogThread

STATUS_BYTES = 4096
STATUS_PERIOD_S = 0.02
"""Period at which the guard checks controller and parent, and publishes its status."""
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

        ``phase`` is ``ready`` (self-test passed, watching), ``ended`` or ``failed`` (``reason``
        says why); the rest are the fields of :class:`GuardReport`, and ``at_s`` on the monotonic
        clock.
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


class _Status:
    """Publishes the loop's state, and checks regularly that controller and parent are there."""

    def __init__(self, ring: SharedRing) -> None:
        self._ring = ring
        self._due_s = 0.0
        self._parent = multiprocessing.parent_process()

    def check(self, loop: ContactLoop, arm: Arm, watchdog: Watchdog) -> None:
        if time.monotonic() < self._due_s:
            return
        self._due_s = time.monotonic() + STATUS_PERIOD_S
        if self._parent is not None and not self._parent.is_alive():
            watchdog.disconnected("the process that asked for the guard is gone")
        state = arm.state()
        if state in (ArmState.PROTECTIVE_STOP, ArmState.DISCONNECTED):
            watchdog.disconnected(f"the arm's controller: {state.value}")
        self.publish("ready", loop.report())

    def publish(self, phase: str, report: GuardReport | None = None, reason: str = "") -> None:
        fields = {} if report is None else asdict(report) | {"health": report.health.value}
        state = {"phase": phase, "reason": reason, "at_s": time.monotonic()} | fields
        self._ring.publish(json.dumps(state).encode())


def _guard(
    arrivals: Factory[Iterator[Arrival]],
    make_detector: Factory[ContactDetector],
    make_arm: Factory[Arm],
    config: WatchdogConfig,
    recorder: Any,
    ring_name: str,
) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when to stop
    status = _Status(SharedRing.attach(ring_name, STATUS_BYTES))
    try:
        detector, arm = make_detector(), make_arm()
    except Exception as error:  # the parent has no other way to learn of it
        status.publish("failed", reason=f"{type(error).__name__}: {error}")
        return
    subscribers = [] if recorder is None else [Subscriber(recorder)]
    watchdog = Watchdog(config, arm.stop, time.monotonic)
    loop = ContactLoop(detector, watchdog, arm.stop, subscribers)
    try:
        stream = arrivals()
        first = next(stream)  # opening a camera takes longer than the allowed silence
        detector.update(first.window)  # compiling takes as long
        detector.reset()
        watchdog.self_test()
        watchdog.arm()
        with WatchdogThread(watchdog):
            report = loop.guard(
                _with(first, stream), lambda loop: status.check(loop, arm, watchdog)
            )
        status.publish("ended", report, report.reason)
    except BaseException as error:
        watchdog.disconnected(f"{type(error).__name__}: {error}")
        status.publish("failed", loop.report(), watchdog.reason)
        raise
    finally:
        if recorder is not None:
            recorder.cancel_join_thread()  # a recorder that hangs must not keep the process


def _with(first: Arrival, others: Iterator[Arrival]) -> Iterator[Arrival]:
    yield first
    yield from others
