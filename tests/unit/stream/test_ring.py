import multiprocessing
import time
from multiprocessing.synchronize import Event

import pytest

from spikingtac.stream.ring import SLOTS, SharedRing

ENOUGH = 200
BYTES = 20_000
PATIENCE_S = 120.0


@pytest.fixture
def ring():
    made = SharedRing.create(slot_bytes=BYTES)
    yield made
    made.close()


def test_a_reader_gets_the_latest_or_nothing(ring: SharedRing) -> None:
    reader = SharedRing.attach(ring.name, slot_bytes=BYTES)
    assert reader.latest(after=0) is None
    for number in range(1, 3 * SLOTS):
        assert ring.publish(bytes([number]) * number)
    assert reader.latest(after=0) == (3 * SLOTS - 1, bytes([3 * SLOTS - 1]) * (3 * SLOTS - 1))
    assert reader.latest(after=3 * SLOTS - 1) is None
    reader.close()


def test_what_does_not_fit_is_refused_and_leaves_the_last_message(ring: SharedRing) -> None:
    assert ring.publish(b"small")
    assert not ring.publish(bytes(BYTES + 1))
    assert ring.latest(after=0) == (1, b"small")


def test_a_torn_message_is_not_used(ring: SharedRing) -> None:
    ring.publish(b"whole message")
    body = ring._slot(1) + 16
    ring._buffer[body : body + 1] = b"X"
    assert ring.latest(after=0) is None


def publish_patterns(name: str, enough: Event) -> None:
    writer = SharedRing.attach(name, slot_bytes=BYTES)
    number = 0
    while not enough.wait(0.0002):
        number += 1
        writer.publish(number.to_bytes(4, "little") * (BYTES // 4))
    writer.close()


def test_another_process_is_read_without_tears(ring: SharedRing) -> None:
    context = multiprocessing.get_context("spawn")
    enough = context.Event()
    process = context.Process(target=publish_patterns, args=(ring.name, enough))
    process.start()
    last, seen, until_s = 0, 0, time.monotonic() + PATIENCE_S
    while seen < ENOUGH and time.monotonic() < until_s:
        got = ring.latest(after=last)
        if got is None:
            continue
        sequence, message = got
        assert sequence > last
        assert message == sequence.to_bytes(4, "little") * (BYTES // 4)
        last, seen = sequence, seen + 1
    enough.set()
    process.join(timeout=PATIENCE_S)
    assert process.exitcode == 0
    assert seen == ENOUGH
