"""A ring in shared memory: in order, never torn, and exact about what a slow reader has missed."""

import multiprocessing
import os
import time
from multiprocessing.synchronize import Event

import numpy as np
import pytest

from spikingtac.errors import DeviceError
from spikingtac.stream.ring import CLOSED, RingReader, SharedRing

ENOUGH = 200
SLOTS, BYTES = 4, 20_000
PATIENCE_S = 120.0


@pytest.fixture
def ring():
    made = SharedRing.create(SLOTS * BYTES)
    yield made
    made.close()


def test_a_reader_gets_the_latest_or_nothing(ring: SharedRing) -> None:
    other = SharedRing.attach(ring.name)
    reader = RingReader(other)
    assert reader.latest() is None
    for number in range(1, 3 * SLOTS):
        assert ring.publish(bytes([number]) * number)
    assert reader.latest() == bytes([3 * SLOTS - 1]) * (3 * SLOTS - 1)
    assert reader.lost == 3 * SLOTS - 2
    assert reader.latest() is None
    assert ring.publish(b"next")
    assert reader.latest() == b"next"
    other.close()


def test_what_does_not_fit_is_refused_and_leaves_the_last_message(ring: SharedRing) -> None:
    assert ring.publish(b"small")
    assert not ring.publish(bytes(SLOTS * BYTES + 1_000))
    assert RingReader(ring).latest() == b"small"


def test_a_damaged_message_is_not_used_and_counts_as_missed(ring: SharedRing) -> None:
    reader = RingReader(ring)
    ring.publish(b"whole message", weight=5)
    place = bytes(ring.buffer).index(b"whole")
    ring.buffer[place : place + 1] = b"X"
    assert RingReader(ring).latest() is None
    ring.publish(b"next", weight=7)
    assert [bytes(message) for message in iter(reader.next, None)] == [b"next"]
    assert reader.lost == 5


def test_what_a_slow_reader_took_and_missed_adds_up() -> None:
    """Messages of every length, in a ring of a few of them, across whose end some are cut."""
    rng, ring = np.random.default_rng(0), SharedRing.create(5_000)
    reader, late = RingReader(ring), None
    weight = got = 0
    for number in range(3_000):
        length = int(rng.integers(0, 1_700))
        assert ring.publish(bytes(length // 2), bytes(length - length // 2), weight=length)
        weight += length
        if rng.random() < 0.4 and (data := reader.next()) is not None:
            got += len(data)
        if number == 1_000:
            late, late_from = RingReader(ring, from_now=True), weight
    got += sum(map(len, iter(reader.next, None)))
    assert got + reader.lost == weight
    assert reader.lost > weight // 10 < got
    taken = sum(map(len, iter(late.next, None)))
    assert taken + late.lost == weight - late_from
    ring.close()


def test_a_name_is_taken_while_its_writer_lives_and_free_afterwards() -> None:
    name = f"spikingtac-test-{os.getpid()}"
    first = SharedRing.create(1_000, name)
    with pytest.raises(DeviceError, match="another program shares"):
        SharedRing.create(1_000, name)
    first.put(CLOSED, 1)
    second = SharedRing.create(1_000, name)
    assert second.publish(b"new")
    second.close()
    first.close()


def publish_patterns(name: str, enough: Event) -> None:
    writer = SharedRing.attach(name)
    number = 0
    while not enough.wait(0.0002):
        number += 1
        writer.publish(number.to_bytes(4, "little") * (BYTES // 4))
    writer.close()


def test_another_process_is_read_without_tears(ring: SharedRing) -> None:
    context = multiprocessing.get_context("spawn")
    enough = context.Event()
    process = context.Process(target=publish_patterns, args=(ring.name, enough), daemon=True)
    process.start()
    reader, taken, until_s = RingReader(ring), 0, time.monotonic() + PATIENCE_S
    while taken < ENOUGH and time.monotonic() < until_s:
        for data in iter(reader.next, None):
            taken += 1
            assert data == (taken + reader.lost).to_bytes(4, "little") * (BYTES // 4)
    enough.set()
    process.join(PATIENCE_S)
    assert taken >= ENOUGH
