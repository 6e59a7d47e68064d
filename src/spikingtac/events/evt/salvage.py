"""Mend damaged RAW words before they are decoded.

Stretches of zeros or 0xFF are found first: a lost sector reads as zeros, erased flash as ones, and
both are words of a RAW format (zeros are events at (0, 0) in EVT2).

Three repairs, each on one chunk: find the word boundaries again where bytes were lost or inserted
(the cheapest path through the byte offsets), drop blocks that are noise, and replace single time
words that contradict their neighbours. Sound chunks never come here.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.events.evt.decode import Integer
from spikingtac.events.formats.codec import JUMP_US

# Price of leaving out a byte, in implausible words avoided; below it, words are believed.
SKIP_COST = 4

BLOCK_WORDS = 64

# Share of undefined types above which a stretch of so many words is noise (random EVT3 words have
# 0.31; half of that, since only one half of the words about its border is noise).
GARBAGE_SHARE = 0.14

GARBAGE_MARGIN_WORDS = 4  # Words about a stretch that go with it: noise may look sound.

NEAR_STEPS = 16  # Steps of the upper time that cost nothing.

# Prices of a longer step forward, of not believing a time word, of a second or more forward, and
# of time going back: one time word speaks for a leap, two for a jump, four for a restart.
LEAP_COST, DISCARD_COST, JUMP_COST, FALL_COST = 1, 2, 3, 7

# Stretches from this length on are no words (no sensor sends 16 events of one pixel in one
# microsecond, or so many empty words).
FILL_BYTES = 64

# Every fourth of the 64-bit numbers is looked at: 39 bytes of fill always hold one of them.
_SAMPLE_STRIDE = 4

_ONES = np.uint64((1 << 64) - 1)

HORIZON = 32  # Time words in a row that may be disbelieved.


def may_be_filled(data: NDArray[np.uint8]) -> bool:
    """Return whether bytes may hold a stretch of fill; quick, since all bytes are tested."""
    samples = data[: len(data) // 8 * 8].view(np.uint64)[::_SAMPLE_STRIDE]
    return bool((samples == 0).any() or (samples == _ONES).any())


def without_fill(words: NDArray[Any], in_fill: bool) -> tuple[NDArray[Any], int, bool]:
    """Drop the stretches of words that are nothing but fill.

    Args:
        words: ``(n,)`` words.
        in_fill: Whether the words before ended in a stretch of fill, which may go on.

    Returns:
        The other words, how many stretches begin here, and whether the last one may go on.
    """
    least = -(-FILL_BYTES // words.itemsize)
    keep, begun = np.ones(len(words), np.bool_), 0
    for fill in (0, int(np.iinfo(words.dtype).max)):
        same = np.concatenate(([False], words == fill, [False]))
        for first, last in np.flatnonzero(same[1:] != same[:-1]).reshape(-1, 2).tolist():
            goes_on = in_fill and first == 0
            if goes_on or last - first >= least:
                keep[first:last] = False
                begun += not goes_on
    return words[keep], begun, len(words) > 0 and not keep[-1]


def aligned(
    data: NDArray[np.uint8], suspects: NDArray[np.bool_], word: np.dtype[Any]
) -> tuple[NDArray[Any], int, int]:
    """Find the word boundaries in bytes that may have lost or gained some.

    Args:
        data: ``uint8[n]``, beginning at a boundary as far as is known.
        suspects: ``bool[n - word + 1]``, true where a word beginning there is implausible.
        word: Type of a word.

    Returns:
        The words (a copy), the bytes consumed, and the number of breaks found.
    """
    starts = np.empty(len(data) // word.itemsize + 1, np.int64)
    count, end, breaks = boundaries_kernel(suspects, len(data), word.itemsize, starts)
    offsets = starts[:count, None] + np.arange(word.itemsize)
    return data[offsets].reshape(-1).view(word).copy(), int(end), int(breaks)


def without_garbage(words: NDArray[Any], unknown: NDArray[np.bool_]) -> tuple[NDArray[Any], int]:
    """Drop the stretches in which too many types are undefined; return the rest and their number.

    Args:
        words: ``(n,)`` words.
        unknown: ``(n,)`` where a word's type is undefined.
    """
    total = np.concatenate(([0], np.cumsum(unknown)))
    places = np.flatnonzero(unknown)
    first = np.maximum(places - BLOCK_WORDS // 2, 0)
    last = np.minimum(places + BLOCK_WORDS // 2, len(words))
    places = places[total[last] - total[first] >= GARBAGE_SHARE * (last - first)]
    if not len(places):
        return words, 0
    stretches = np.split(places, np.flatnonzero(np.diff(places) > BLOCK_WORDS) + 1)
    keep = np.ones(len(words), np.bool_)
    for stretch in stretches:
        keep[max(stretch[0] - GARBAGE_MARGIN_WORDS, 0) : stretch[-1] + GARBAGE_MARGIN_WORDS] = False
    return words[keep], len(stretches)


@njit(cache=True, nogil=True)
def boundaries_kernel(
    bad: NDArray[np.bool_], length: Integer, word_bytes: int, starts: NDArray[np.int64]
) -> tuple[Any, Any, Any]:
    """Return the number of words, the end of the last one and the number of breaks."""
    cost = np.empty(length + 1, np.int32)
    skipped = np.zeros(length + 1, np.bool_)
    cost[0] = 0
    for end in range(1, length + 1):
        cost[end] = cost[end - 1] + SKIP_COST
        skipped[end] = True
        begin = end - word_bytes
        if begin >= 0 and cost[begin] + bad[begin] <= cost[end]:
            cost[end] = cost[begin] + bad[begin]
            skipped[end] = False
    end = length
    for candidate in range(max(length - word_bytes + 1, 0), length):
        if cost[candidate] < cost[end]:
            end = candidate
    position, count, breaks, skipping = end, 0, 0, False
    while position > 0:
        if skipped[position]:
            breaks += not skipping
            skipping = True
            position -= 1
        else:
            skipping = False
            position -= word_bytes
            starts[count] = position
            count += 1
    starts[:count] = starts[:count][::-1].copy()
    return count, end, breaks


@njit(cache=True, nogil=True)
def mend_high_kernel(
    value: NDArray[np.int64], wrapped: NDArray[np.bool_], last: Integer, high_bits: Integer
) -> Any:
    """Replace upper times that do not fit into a course of time, in place; return how many.

    Args:
        value: Upper times in order.
        wrapped: Whether the lower time fell across each.
        last: The upper time before them, or -1.
        high_bits: Bits of the upper time.
    """
    kept = np.zeros(len(value), np.bool_)
    course_kernel(value, last, high_bits, kept)
    period = np.int64(1) << high_bits
    mended = 0
    for k in range(len(value)):
        if not kept[k]:
            follower = k + 1
            while follower < len(value) and not kept[follower]:
                follower += 1
            before = last if last >= 0 or follower == len(value) else value[follower]
            room = (value[follower] - before) % period if follower < len(value) else 1
            value[k] = (before + min(1 if wrapped[k] or room > 1 else 0, room)) % period
            mended += 1
        last = value[k]
    return mended


@njit(cache=True, nogil=True)
def course_kernel(
    value: NDArray[np.int64], last: Integer, high_bits: Integer, kept: NDArray[np.bool_]
) -> None:
    """Mark the upper times that make the cheapest course from ``last`` on (see the prices)."""
    best = np.empty(len(value), np.int64)
    origin = np.full(len(value), -1, np.int64)
    for k in range(len(value)):
        best[k] = k * DISCARD_COST
        if last >= 0:
            best[k] += step_cost_kernel(last, value[k], high_bits)
        elif k:
            best[k] += LEAP_COST
        for j in range(max(k - HORIZON, 0), k):
            through = best[j] + (k - j - 1) * DISCARD_COST
            if through < best[k]:
                through += step_cost_kernel(value[j], value[k], high_bits)
                if through < best[k]:
                    best[k], origin[k] = through, j
    end, price = -1, len(value) * DISCARD_COST
    for k in range(len(value)):
        total = best[k] + (len(value) - 1 - k) * DISCARD_COST
        if total <= price:
            end, price = k, total
    while end >= 0:
        kept[end] = True
        end = origin[end]


@njit(cache=True, nogil=True)
def step_cost_kernel(first: Integer, second: Integer, high_bits: Integer) -> Any:
    """Return the price of believing that one upper time follows another."""
    step = second - first
    ahead = step % (np.int64(1) << high_bits)
    if ahead <= NEAR_STEPS:
        return 0
    # The upper and the lower bits of the time are 24 or 34 together: 12 + 12 or 28 + 6.
    near = ahead < JUMP_US >> (12 if high_bits == 12 else 6)
    if step < 0:
        return LEAP_COST if near else FALL_COST
    return LEAP_COST if near else JUMP_COST
