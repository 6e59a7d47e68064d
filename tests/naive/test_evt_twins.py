"""Decoders, written from the formats' descriptions in plain Python, against the kernels."""

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from spikingtac.events.evt import salvage
from spikingtac.events.evt.encode import Evt2Encoder, Evt3Encoder, Evt21Encoder
from spikingtac.events.evt.words import WordStream
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.records import decode_es_kernel
from spikingtac.types import LossCounters

SIZE = (320, 240)
Events = list[tuple[int, int, int, bool]]


def twin_evt2(words: NDArray[np.uint32]) -> Events:
    events, high = [], 0
    for word in words.tolist():
        kind = word >> 28
        if kind == 8:
            high = word & 0xFFFFFFF
        elif kind in (0, 1):
            t = high << 6 | (word >> 22 & 63)
            events.append((t, word >> 11 & 2047, word & 2047, kind == 1))
    return events


def twin_evt21(words: NDArray[np.uint64]) -> Events:
    events = []
    for word in words.tolist():
        head, mask = word >> 32, word & 0xFFFFFFFF
        if head >> 28 == 8:
            high = head & 0xFFFFFFF
        elif head >> 28 in (0, 1):
            t, x, y = high << 6 | (head >> 22 & 63), head >> 11 & 2047, head & 2047
            events += [(t, x + i, y, head >> 28 == 1) for i in range(32) if mask >> i & 1]
    return events


def twin_evt3(words: NDArray[np.uint16]) -> Events:
    events: Events = []
    high = low = y = x = 0
    epoch, p = 0, False
    for word in words.tolist():
        kind, value = word >> 12, word & 4095
        if kind == 0:
            y = value & 2047
        elif kind == 2:
            events.append((epoch + (high << 12 | low), value & 2047, y, value >> 11 == 1))
        elif kind == 3:
            x, p = value & 2047, value >> 11 == 1
        elif kind in (4, 5):
            width = 12 if kind == 4 else 8
            t = epoch + (high << 12 | low)
            events += [(t, x + i, y, p) for i in range(width) if value >> i & 1]
            x += width
        elif kind == 6:
            low = value
        elif kind == 8:
            epoch += (1 << 24) if high - value >= 2048 else 0
            high, low = value, low if value == high else 0
    return events


def events(rng: np.random.Generator, n: int, span_us: int) -> tuple[NDArray, ...]:
    t = np.sort(rng.integers(0, span_us, n)).astype(np.int64)
    x = rng.integers(0, SIZE[0], n).astype(np.uint16)
    y = rng.integers(0, 40, n).astype(np.uint16)
    p = rng.random(n) < 0.5
    order = np.lexsort((x, p, y, t))
    return t[order], x[order], y[order], p[order]


def as_tuples(t: NDArray, x: NDArray, y: NDArray, p: NDArray) -> Events:
    return list(zip(t.tolist(), x.tolist(), y.tolist(), p.tolist(), strict=True))


CODECS = [
    pytest.param(Evt2Encoder, twin_evt2, id="evt2"),
    pytest.param(Evt21Encoder, twin_evt21, id="evt21"),
    pytest.param(Evt3Encoder, twin_evt3, id="evt3"),
]


@pytest.mark.parametrize(("encoder", "twin"), CODECS)
@pytest.mark.parametrize(
    ("n", "span_us"), [(0, 1), (1, 1), (500, 20), (2000, 5000), (300, 1 << 26)]
)
def test_encoder_twin_and_decoder_agree(encoder, twin, n, span_us) -> None:
    columns = events(np.random.default_rng(n), n, span_us)
    words = encoder().encode(*columns)
    assert twin(words) == as_tuples(*columns)
    losses = LossCounters()
    x, y, p, t = WordStream(encoder.name, SIZE, losses, Triggers()).feed(words.tobytes(), True)
    assert (as_tuples(t, x, y, p), losses) == (as_tuples(*columns), {})


def cost_of_path(bad: list[int], path: tuple[int, ...], word: int) -> int:
    position, cost = 0, 0
    for step in path:
        cost += salvage.SKIP_COST if step == 1 else int(bad[position])
        position += step
    return cost


@pytest.mark.parametrize("word", [2, 4])
def test_boundaries_are_the_cheapest_path(word: int) -> None:
    rng = np.random.default_rng(word)
    for _ in range(20):
        length = int(rng.integers(word, 13))
        bad = rng.random(max(length - word + 1, 0)) < 0.5
        starts = np.empty(length // word + 1, np.int64)
        count, end, _ = salvage.boundaries_kernel(bad, length, word, starts)
        paths = [
            path
            for steps in range(1, length + 1)
            for path in itertools.product((1, word), repeat=steps)
            if length - word < sum(path) <= length
        ]
        best = min(cost_of_path(bad.tolist(), path, word) for path in paths)
        skipped = end - count * word
        found = salvage.SKIP_COST * skipped + sum(int(bad[s]) for s in starts[:count])
        assert found == best


def test_course_is_the_cheapest_subset() -> None:
    rng = np.random.default_rng(8)
    for _ in range(60):
        value = rng.integers(0, 4096, 7)
        value[: rng.integers(0, 7)] = np.arange(rng.integers(0, 100), 10_000)[: len(value)][0]
        last = int(rng.integers(-1, 4096))
        kept = np.zeros(7, np.bool_)
        salvage.course_kernel(value, last, 12, kept)
        prices = [
            price_of(value, last, np.array(choice, bool))
            for choice in itertools.product((False, True), repeat=7)
        ]
        assert price_of(value, last, kept) == min(prices)


def price_of(value: NDArray, last: int, kept: NDArray) -> int:
    price = salvage.DISCARD_COST * int((~kept).sum())
    chosen = value[kept].tolist()
    if chosen:
        price += (
            int(salvage.step_cost_kernel(last, chosen[0], 12))
            if last >= 0
            else salvage.LEAP_COST * (not kept[0])
        )
    pairs = itertools.pairwise(chosen)
    return price + sum(int(salvage.step_cost_kernel(a, b, 12)) for a, b in pairs)


def test_es_kernel_equals_twin() -> None:
    data = np.random.default_rng(5).integers(0, 256, 997).astype(np.uint8)
    data[::7] = 0xFF
    t, i, twin = 0, 0, []
    while i < len(data):
        if data[i] >= 0xFE:
            t += 127 * int(data[i] == 0xFF)
            i += 1
        elif i + 5 > len(data):
            break
        else:
            t += int(data[i]) >> 1
            x, y = np.frombuffer(data[i + 1 : i + 5].tobytes(), "<u2").tolist()
            twin.append((t, x, y, bool(data[i] & 1)))
            i += 5
    room = len(data)
    columns = [np.empty(room, kind) for kind in (np.int64, np.int64, np.bool_, np.int64)]
    n, end = decode_es_kernel(data, tuple(columns), np.zeros(1, np.int64))
    x, y, p, t_column = (column[:n] for column in columns)
    assert (as_tuples(t_column, x, y, p), end) == (twin, i)
