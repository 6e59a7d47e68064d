"""Copies of a tracker along its stream, bounded in bytes, to resume from an earlier time.

Most of what a tracker holds never changes (its calibration, its tables, its work space). An array
that equals the one of the copy before is not stored again, which makes a copy a sixth as large.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar
from weakref import ref

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")

# First distance between kept copies; tracking 0.25 s again takes a fraction of it.
FIRST_DISTANCE_US = 250_000

# Most bytes of arrays in all copies; beyond it every other copy goes, and the distance doubles.
MOST_BYTES = 64 << 20
MOST_COPIES = 64  # The same bound for trackers with little state.


@dataclass(frozen=True, slots=True)
class _Copy(Generic[T]):
    t_us: int
    parts: T
    arrays: dict[int, NDArray[Any]]


class TrackerHistory(Generic[T]):
    """Keeps copies of a state, thinned out as they become many, so that memory stays bounded.

    Attributes:
        distance_us: Time between two kept copies.
    """

    def __init__(self) -> None:
        self.distance_us = FIRST_DISTANCE_US
        self._copies: list[_Copy[T]] = []
        self._pairs: list[tuple[ref[NDArray[Any]], NDArray[Any]]] = []
        self._possible = True

    def __len__(self) -> int:
        return len(self._copies)

    @property
    def kept_bytes(self) -> int:
        """Bytes of the arrays in all copies, each array counted once."""
        arrays = {key: array for kept in self._copies for key, array in kept.arrays.items()}
        return sum(array.nbytes for array in arrays.values())

    def offer(self, t_us: int, t_start_us: int, parts: T) -> None:
        """Keep a copy of ``parts`` where the last one is far enough back.

        Args:
            t_us: Time of the state.
            t_start_us: Time of the stream's beginning, which needs no copy.
            parts: The state; what cannot be copied (a network's session) is never kept.
        """
        last_us = self._copies[-1].t_us if self._copies else t_start_us
        if not self._possible or t_us < last_us + self.distance_us:
            return
        shared = {id(live): (live, kept) for live, kept in self._alive() if _equal(live, kept)}
        memo: dict[int, Any] = {key: kept for key, (_, kept) in shared.items()}
        try:
            kept_parts = copy.deepcopy(parts, memo)
        except TypeError:
            self._possible = False
            return
        pairs = [*shared.values(), *_copied(memo)]
        self._pairs = [(ref(live), kept) for live, kept in pairs]
        self._copies.append(_Copy(t_us, kept_parts, {id(kept): kept for _, kept in pairs}))
        self._thin_out()

    def before(self, t_us: int) -> tuple[int, T] | None:
        """Return ``(time, state)`` of the last copy at or before a time, or None.

        The state is the caller's own; the kept one stays as it is.
        """
        found = [kept for kept in self._copies if kept.t_us <= t_us]
        if not found:
            return None
        memo: dict[int, Any] = {}
        parts = copy.deepcopy(found[-1].parts, memo)
        self._pairs = [(ref(live), kept) for kept, live in _copied(memo)]
        return found[-1].t_us, parts

    def _alive(self) -> Iterator[tuple[NDArray[Any], NDArray[Any]]]:
        """Yield the arrays of the state that are still in use, with their latest kept copies."""
        for reference, kept in self._pairs:
            live = reference()
            if live is not None:
                yield live, kept

    def _thin_out(self) -> None:
        while len(self._copies) > 1 and (
            len(self._copies) > MOST_COPIES or self.kept_bytes > MOST_BYTES
        ):
            self._copies = self._copies[1::2]
            self.distance_us *= 2


def _copied(memo: dict[int, Any]) -> list[tuple[NDArray[Any], NDArray[Any]]]:
    """Return ``(original, copy)`` of every array that a deep copy made."""
    # copy.deepcopy lists under its memo's own id every original that it made a copy of.
    originals = memo.get(id(memo), [])
    return [(item, memo[id(item)]) for item in originals if isinstance(item, np.ndarray)]


def _equal(one: NDArray[Any], other: NDArray[Any]) -> bool:
    if one.shape != other.shape or one.dtype != other.dtype:
        return False
    return bool(np.array_equal(one, other, equal_nan=one.dtype.kind == "f"))
