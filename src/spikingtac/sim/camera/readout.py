"""The way out of the chip: order of time, the arbiter's rate, random loss."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.camera.config import ReadoutConfig
from spikingtac.sim.camera.pixels import KEY_SHIFT
from spikingtac.sim.camera.random import uniform_kernel
from spikingtac.types import EventPacket, LossCounters

_PIXEL_BITS = (1 << KEY_SHIFT) - 1


class Arbiter(NamedTuple):
    """A server that lets one event pass at a time, in order of time, row and column.

    Attributes:
        event_us: Time that an event takes.
        row_us: Time to switch to another row.
        backlog_us: Longest wait; events beyond it are lost.
        loss: Share lost at random behind the server.
        width: Pixels in a row.
        free_us: ``(1,)`` when the server is free again.
        row: ``(1,)`` row of the last event.
        served: ``(1,)`` events that passed the server.
        key: Of the random numbers.
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
def serve_kernel(
    keys: NDArray[np.int64], arbiter: Arbiter, out: NDArray[np.int64]
) -> tuple[int, int, int]:
    """Pass events through the arbiter.

    Args:
        keys: ``(n,)`` sorted keys.
        arbiter: Its state is advanced.
        out: ``(n,)`` gets the keys of the surviving events, restamped, in order.

    Returns:
        Events kept, dropped for their backlog, lost at random.
    """
    kept = dropped = lost = 0
    for key in keys:
        asked_us = float(key >> KEY_SHIFT)
        row = ((key & _PIXEL_BITS) >> 1) // arbiter.width
        start_us = max(asked_us, arbiter.free_us[0])
        if start_us - asked_us > arbiter.backlog_us:
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
    """Collects the pixels' events and gives them out in order of time.

    Events that a latency or the arbiter carries beyond an interval wait for the next one.

    Args:
        config: Cap and losses.
        size: ``(width, height)`` of the sensor.
        rng: For the key of the random loss.
        losses: Counted into: ``readout_overflow`` and ``readout_loss``.
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
        self._through = cap is None and config.row_us == 0 and config.loss == 0
        self._early: list[NDArray[np.int64]] = []
        self._late = np.empty(0, np.int64)
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
        """Forget the events that wait, and start again."""
        self._since_us = now_us
        self._early = []
        self._late = np.empty(0, np.int64)
        self._arbiter.free_us[0] = -np.inf

    def collect(self, keys: NDArray[np.int64]) -> None:
        """Take events in any order (copied)."""
        if len(keys):
            self._early.append(keys.copy())

    def release(self, until_us: int) -> NDArray[np.int64]:
        """Return the keys of all events stamped before ``until_us``, sorted by time."""
        if not self._early:
            waiting = np.empty(0, np.int64)
        else:
            waiting = self._early[0] if len(self._early) == 1 else np.concatenate(self._early)
            waiting.sort()
        waiting = _not_before(waiting, self._since_us)
        self._since_us = until_us
        limit = np.int64(until_us) << KEY_SHIFT
        ready = int(np.searchsorted(waiting, limit))
        self._early = [waiting[ready:]] if ready < len(waiting) else []
        if self._through:
            return waiting[:ready]
        served = np.empty(ready, np.int64)
        kept, dropped, lost = serve_kernel(waiting[:ready], self._arbiter, served)
        self._losses.add("readout_overflow", int(dropped))
        self._losses.add("readout_loss", int(lost))
        passed = np.concatenate([self._late, served[:kept]])
        # The arbiter keeps the order of time, so a cut separates what is still under way.
        out = int(np.searchsorted(passed >> KEY_SHIFT, until_us))
        self._late = passed[out:]
        return passed[:out]

    def packet(self, parts: list[NDArray[np.int64]], t_start_us: int, t_end_us: int) -> EventPacket:
        """Return released keys as a packet."""
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
    """Restamp sorted keys that rounding put a microsecond before their interval."""
    start = np.int64(since_us) << KEY_SHIFT
    early = int(np.searchsorted(keys, start))
    if early:
        keys[:early] = start | (keys[:early] & _PIXEL_BITS)
        keys.sort()
    return keys
