"""The watchdog: when the sensor's stream can no longer be trusted, the arm stops.

Not a safety function: it has no performance level, and it does not replace the robot's protective
stop (ISO 10218, ISO 13849). It catches the faults of this software's own stream, and nothing else.
"""

from __future__ import annotations

import contextlib
import enum
import threading
import time
from collections.abc import Callable

from spikingtac.errors import ConfigError, DeviceError


class Health(enum.Enum):
    """State of the stream, as the watchdog judges it."""

    OK = "ok"
    STALE = "stale"
    OVERLOAD = "overload"
    TIME_JUMP = "time_jump"
    DISCONNECTED = "disconnected"
    NOT_STOPPED = "not_stopped"


# Longest time without a heartbeat, s. The arm is to rest within 0.2 s of a fault, of which the stop
# itself takes up to 0.11; the rest is room for a virtual machine, which held up a process of
# real-time priority for 14 ms four times a minute, and for 26 ms once in 40 minutes.
STALE_S = 0.04
BACKLOG_S = 0.005  # Longest delay of processed data behind the newest, s (five windows).

# Time between checks, s: the arm is told to stop within ``stale_s`` and a period, or two where the
# process did not run.
PERIOD_S = 0.002


class Watchdog:
    """Trips once and stays tripped until :meth:`reset`; at first it is disarmed and not tested.

    A heartbeat says that the camera's transport is alive. It does not depend on the rate of events,
    since a sensor at rest sends none.

    Args:
        stop: Tells the arm to stop and returns at once; called at each trip, also when it was
            called before.
        clock_s: A monotonic clock, s.
        on_trip: Called at the first trip, after the stop was sent, and again when :attr:`reason`
            or :attr:`stop_failure` changes; it must not block. What it raises is ignored.
        confirm: Waits until the arm rests, and raises where it does not. What it or ``stop`` raises
            is kept in :attr:`stop_failure`, and every later :meth:`check` stops again.
        stale_s: Longest time without a heartbeat, s.
        backlog_s: Longest delay of processed data behind the newest, s.

    Attributes:
        backlog_s: The same.
        health: OK, or the first fault since the last reset; a disconnection goes before a silence.
        reason: What tripped it, in words; empty while OK.
        stop_failure: What the last attempt to stop raised, or None.
        armed: True between :meth:`arm` and a trip or :meth:`disarm`.
    """

    def __init__(
        self,
        stop: Callable[[], None],
        clock_s: Callable[[], float],
        on_trip: Callable[[], None] = lambda: None,
        confirm: Callable[[], None] = lambda: None,
        *,
        stale_s: float = STALE_S,
        backlog_s: float = BACKLOG_S,
    ) -> None:
        if not (stale_s > 0.0 and backlog_s > 0.0):
            raise ConfigError("stale_s and backlog_s must be positive")
        self._stale_s, self.backlog_s = stale_s, backlog_s
        self._clock_s, self._on_trip = clock_s, on_trip
        self._stop, self._confirm = stop, confirm
        self._beat_s, self._lag_s = clock_s(), 0.0
        self._lock = threading.RLock()
        self.reset()

    def beat(self, backlog_s: float = 0.0) -> None:
        """Say that the transport is alive.

        Args:
            backlog_s: How far the processed data lag behind the newest received, s.
        """
        self._beat_s = self._clock_s()
        self._lag_s = backlog_s

    def disconnected(self, reason: str) -> None:
        """Say that the transport or the controller is gone for certain."""
        self._trip(Health.DISCONNECTED, reason)

    def time_jump(self, reason: str) -> None:
        """Report that the sensor's clock leapt; trips while armed."""
        with self._lock:
            if self.armed:
                self._trip(Health.TIME_JUMP, reason)

    def stop_failed(self, error: Exception) -> None:
        """Report that a stop which was sent elsewhere, at a contact, did not stop the arm."""
        with self._lock:
            if self.health is Health.OK:
                self.health, self.reason = Health.NOT_STOPPED, "the arm did not stop at a contact"
            self.armed, self.stop_failure = False, error
            self._tell()

    def check(self) -> Health:
        """Read the clock, trip if it is time, and return the health; call it in every window.

        A disarmed watchdog does not trip, but a tripped one stays so.
        """
        with self._lock:
            if self.health is not Health.OK:
                if self.stop_failure is not None:
                    self._stop_now()
            elif self.armed:
                self._judge()
            return self.health

    def require_ok(self) -> None:
        """Check, and raise after a trip.

        Raises:
            DeviceError: It has tripped, now or before.
        """
        if self.check() is not Health.OK:
            raise DeviceError(f"the watchdog stopped the arm: {self.health.value}, {self.reason}")

    def self_test(self) -> None:
        """Test that a fault trips it and that the arm obeys a stop; needed before arming.

        Raises:
            DeviceError: The watchdog is tripped or armed, or the arm did not obey the stop.
        """
        with self._lock:
            if self.armed or self.health is not Health.OK:
                raise DeviceError("the watchdog's self-test needs it disarmed and reset")
            self._proven = False
            self._beat_s = self._clock_s() - 2.0 * self._stale_s
            self._judge()
            tripped, failure = self.health is Health.STALE, self.stop_failure
            self._clear()
        if not tripped or failure is not None:
            raise DeviceError(f"the watchdog's self-test could not stop the arm: {failure}")
        self._proven = True

    def arm(self, patience_s: float = 0.0) -> None:
        """Start watching, or go on with another patience.

        Args:
            patience_s: How much longer than ``stale_s`` a silence may last, s.

        Raises:
            DeviceError: It is tripped, or :meth:`self_test` was not passed since the last reset.
        """
        if self.health is not Health.OK:
            raise DeviceError(
                f"the watchdog tripped ({self.health.value}: {self.reason}); reset it first"
            )
        if not self._proven:
            raise DeviceError("run the watchdog's self_test before arming it")
        self._beat_s, self._lag_s = self._clock_s(), 0.0
        self._patience_s, self.armed = patience_s, True

    def disarm(self) -> None:
        """Stop watching; a trip stays."""
        self.armed = False

    def reset(self) -> None:
        """Clear a trip; the self-test has to be passed again."""
        self._clear()
        self._proven = False

    def _judge(self) -> None:
        silent_s = self._clock_s() - self._beat_s
        if silent_s > self._stale_s + self._patience_s:
            self._trip(Health.STALE, f"no heartbeat for {silent_s * 1e3:.1f} ms")
        elif self._lag_s > self.backlog_s:
            lag_ms, most_ms = 1e3 * self._lag_s, 1e3 * self.backlog_s
            advice = f"{most_ms:g} ms are allowed: free the computer of other work"
            self._trip(Health.OVERLOAD, f"data lag {lag_ms:.1f} ms behind, {advice}")

    def _trip(self, health: Health, reason: str) -> None:
        with self._lock:
            # What is gone for certain explains a silence that tripped just before.
            gone = health is Health.DISCONNECTED
            first = self.health is Health.OK or (gone and self.health is Health.STALE)
            if first:
                self.health, self.reason = health, reason
            self.armed = False
            self._stop_now(tell=first)

    def _stop_now(self, tell: bool = False) -> None:
        """Stop, report on request, wait for the outcome, and report that where it is new."""
        former = self.stop_failure
        self.stop_failure = _failure_of(self._stop)
        if tell:
            self._tell()
            former = self.stop_failure
        self.stop_failure = self.stop_failure or _failure_of(self._confirm)
        if str(self.stop_failure) != str(former):
            self._tell()

    def _tell(self) -> None:
        if self._proven:  # the self-test's own trip is not reported
            with contextlib.suppress(Exception):  # a failed report must not end the watch
                self._on_trip()

    def _clear(self) -> None:
        self.health, self.reason, self.armed = Health.OK, "", False
        self._patience_s = 0.0
        self.stop_failure: Exception | None = None


def _failure_of(command: Callable[[], None]) -> Exception | None:
    try:
        command()
    except Exception as error:  # whatever the driver raises must not end the watch
        return error
    return None


class WatchdogThread:
    """Checks a watchdog from a thread of its own, so that a loop that hangs is caught too.

    Used as a context; the thread ends with it. A check that comes late by more than a period tells
    of this process, which did not run, not of the stream: it is left out, once, so that what came
    meanwhile is read first.

    Args:
        watchdog: What to check.
    """

    def __init__(self, watchdog: Watchdog) -> None:
        self._watchdog = watchdog
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watchdog", daemon=True)

    def __enter__(self) -> WatchdogThread:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._end.set()
        self._thread.join()

    def _run(self) -> None:
        checked_s, left_out = time.monotonic(), False
        while not self._end.wait(PERIOD_S):
            left_out = not left_out and time.monotonic() - checked_s > 2.0 * PERIOD_S
            if not left_out:
                self._watchdog.check()
            checked_s = time.monotonic()
