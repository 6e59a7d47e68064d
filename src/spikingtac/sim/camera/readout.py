"""Readout of the sensor: order of time, rate limit of the arbiter, and random loss."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.camera.config import ReadoutConfig
from spikingtac.sim.camera.pixel_records import KEY_SHIFT
from spikingtac.sim.camera.random import uniform_kernel
from spikingtac.types import EventPacket, LossCounters

_PIXEL_BITS = (1 << KEY_SHIFT) - 1


class Arbiter(NamedTuple):
    """A server that passes one event at a time, in order of time, row and column.

    Attributes:
        event_us: Service time of an event, us.
        row_us: Time to switch to another row, us.
        backlog_us: Longest wait, us. Events that would wait longer are dropped.
        loss: Fraction of the events that is lost at random behind the server.
        width: Number of pixels in a row.
        free_us: ``(1,)`` time from which the server is free, us.
        row: ``(1,)`` row of the last event.
        served: ``(1,)`` number of events that the server has passed.
        key: Key of the random numbers.
    """

    event_us: float
    row_us: float
    backlog_us: float
    loss: float
    width: int
    free_us: NDArray[np.float64]
    row: NDArray[np.int64]
    served: NDArray[np.uint64]
    key: np.uint64


@njit(cache=True, nogil=True, error_model="numpy")
def arbitrate_kernel(
    keys: NDArray[np.int64], arbiter: Arbiter, out: NDArray[np.int64]
) -> tuple[int, int, int]:
    """Pass events through the arbiter.

    Args:
        keys: ``(n,)`` sorted keys.
        arbiter: Arbiter whose state is advanced.
        out: ``(n,)`` receives the keys of the remaining events, with new time stamps, in order.

    Returns:
        Numbers of events kept, dropped because of their wait, and lost at random.
    """
    kept = dropped = lost = 0
    for key in keys:
        requested_us = float(key >> KEY_SHIFT)
        row = ((key & _PIXEL_BITS) >> 1) // arbiter.width
        start_us = max(requested_us, arbiter.free_us[0])
        if start_us - requested_us > arbiter.backlog_us:
            dropped += 1
            continue
        if row != arbiter.row[0]:
            start_us += arbiter.row_us
            arbiter.row[0] = row
        arbiter.free_us[0] = start_us + arbiter.event_us
        draw = uniform_kernel(arbiter.key, arbiter.served[0])
        arbiter.served[0] += np.uint64(1)
        if draw < arbiter.loss:
            lost += 1
            continue
        out[kept] = (np.int64(math.floor(start_us)) << KEY_SHIFT) | (key & _PIXEL_BITS)
        kept += 1
    return kept, dropped, lost


class Readout:
    """Collects the events of the pixels and returns them in order of time.

    An event that latency or arbiter delay beyond an interval is returned with a later interval.

    Args:
        config: Rate limit and losses.
        size: ``(width, height)`` of the sensor, px.
        rng: Source of the key of the random loss.
        losses: Counters ``readout_overflow`` and ``readout_loss``, which are increased.
    """

    def __init__(
        self,
        config: ReadoutConfig,
        size: tuple[int, int],
        rng: np.random.Generator,
        losses: LossCounters,
    ) -> None:
        cap = config.cap_mev_s
        self._size = size
        self._losses = losses
        self._unlimited = cap is None and config.row_us == 0 and config.loss == 0
        self._pending: list[NDArray[np.int64]] = []
        self._delayed = np.empty(0, np.int64)
        self._since_us = 0
        self._arbiter = Arbiter(
            event_us=0.0 if cap is None else 1.0 / cap,
            row_us=config.row_us,
            backlog_us=config.backlog_us,
            loss=config.loss,
            width=size[0],
            free_us=np.full(1, -np.inf),
            row=np.full(1, -1, np.int64),
            served=np.zeros(1, np.uint64),
            key=np.uint64(rng.integers(0, 1 << 63)),
        )

    def reset(self, now_us: int) -> None:
        """Drop all pending events and start again at ``now_us``."""
        self._since_us = now_us
        self._pending = []
        self._delayed = np.empty(0, np.int64)
        self._arbiter.free_us[0] = -np.inf

    def collect(self, keys: NDArray[np.int64]) -> None:
        """Add the keys of events, in any order. The keys are copied."""
        if len(keys):
            self._pending.append(keys.copy())

    def release(self, until_us: int) -> NDArray[np.int64]:
        """Return the keys of all events with a time stamp before ``until_us``, sorted by time."""
        if not self._pending:
            pending = np.empty(0, np.int64)
        else:
            pending = self._pending[0] if len(self._pending) == 1 else np.concatenate(self._pending)
            pending.sort()
        pending = _not_before(pending, self._since_us)
        self._since_us = until_us
        limit = np.int64(until_us) << KEY_SHIFT
        ready = int(np.searchsorted(pending, limit))
        self._pending = [pending[ready:]] if ready < len(pending) else []
        if self._unlimited:
            return pending[:ready]
        served = np.empty(ready, np.int64)
        kept, dropped, lost = arbitrate_kernel(pending[:ready], self._arbiter, served)
        self._losses.add("readout_overflow", int(dropped))
        self._losses.add("readout_loss", int(lost))
        passed = np.concatenate([self._delayed, served[:kept]])
        # The arbiter keeps the order of time, so one cut separates the delayed events.
        out = int(np.searchsorted(passed >> KEY_SHIFT, until_us))
        self._delayed = passed[out:]
        return passed[:out]

    def packet(self, parts: list[NDArray[np.int64]], t_start_us: int, t_end_us: int) -> EventPacket:
        """Return released keys as a packet of the span from ``t_start_us`` to ``t_end_us``."""
        keys = np.concatenate(parts) if parts else np.empty(0, np.int64)
        y, x = np.divmod((keys & _PIXEL_BITS) >> 1, self._size[0])
        return EventPacket(
            x=x.astype(np.uint16),
            y=y.astype(np.uint16),
            p=(keys & 1).astype(np.bool_),
            t=keys >> KEY_SHIFT,
            t_start_us=t_start_us,
            t_end_us=t_end_us,
            size=self._size,
        )


def _not_before(keys: NDArray[np.int64], since_us: int) -> NDArray[np.int64]:
    """Raise the time stamp of sorted keys that rounding put before their interval."""
    start = np.int64(since_us) << KEY_SHIFT
    early = int(np.searchsorted(keys, start))
    if early:
        keys[:early] = start | (keys[:early] & _PIXEL_BITS)
        keys.sort()
    return keys
