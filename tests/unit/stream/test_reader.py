"""A stream that a thread or a process reads: in order, exact about loss, and open to others."""

import os
import socket
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest

from spikingtac.errors import ConfigError, DeviceError, RecordingError
from spikingtac.events.camera import Address
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.file_source import ReadOptions
from spikingtac.sim.twin_camera import RemoteSource
from spikingtac.stream.packets import PacketReader, PacketWriter, RingCamera, new_ring
from spikingtac.stream.reader import EventReader
from spikingtac.types import EventPacket, LossCounters
from stand_ins.camera_counterparts import datagrams, events
from stand_ins.random_packets import assert_equal

NAME = f"test-{os.getpid()}"
ADDRESS = Address.parse(f"ring:{NAME}")
SIZE = (12, 10)


def packet(number: int, events: int = 100) -> EventPacket:
    t = 10_000 * number + np.arange(events, dtype=np.int64)
    x, y = (t % 12).astype(np.uint16), (t % 10).astype(np.uint16)
    return EventPacket(x, y, x > y, t, int(t[0]), int(t[-1]) + 1, SIZE)


class Stream:
    """Packets with losses and trigger edges; an error at the end where one is given."""

    def __init__(self, count: int, error: Exception | None = None, pause_s: float = 0.0) -> None:
        self.size, self.losses, self.triggers = SIZE, LossCounters(), Triggers()
        self._count, self._error, self._pause_s = count, error, pause_s

    def __iter__(self) -> Iterator[EventPacket]:
        for number in range(self._count):
            time.sleep(self._pause_s)
            if number % 3 == 2:
                self.losses.add("gap")
                self.triggers.append(10_000 * number, 1, True)
            yield packet(number)
        if self._error is not None:
            raise self._error


def read(stream: Stream) -> EventReader:
    return EventReader(stream, stream, new_ring(SIZE, 1 << 20))


def test_everything_comes_in_order_with_losses_and_edges() -> None:
    reader = read(Stream(30))
    found = list(reader)
    whole = EventPacket.concatenate([one.packet for one in found])
    sent = EventPacket.concatenate([packet(number) for number in range(30)])
    assert_equal(whole, sent)
    assert all(getattr(whole, column).flags.writeable for column in "xypt")
    assert dict(reader.losses) == {"gap": 10}
    edges = Triggers()
    for one in found:
        edges.extend(one.triggers)
    assert edges.t_us.tolist() == [10_000 * number for number in range(2, 30, 3)]
    with pytest.raises(EOFError):
        reader.take()
    reader.release()


def test_a_source_that_is_iterated_again_shows_its_new_edges() -> None:
    stream, ring = Stream(0), new_ring(SIZE, 1 << 16)
    writer, reader = PacketWriter(ring, stream), PacketReader(ring)
    for t_us in ([5], [7], [9, 11]):
        stream.triggers.clear()  # as an iteration begins
        stream.triggers.append(t_us, 1, True)
        writer.write(packet(0))
        found = reader.take()
        assert found.triggers.t_us.tolist() == t_us
    ring.close()


def test_a_packet_that_is_larger_than_the_ring_is_cut_and_counted() -> None:
    reader = EventReader(iter([packet(0, 20_000)]), Stream(0), new_ring(SIZE, 40_000))
    taken = sum(len(one.packet) for one in reader)
    assert taken + reader.losses["missed"] == 20_000
    assert taken > 0
    reader.release()


@pytest.mark.parametrize("error", [RecordingError("cable"), OSError("usb")])
def test_what_ends_a_stream_is_raised_after_its_last_event(error: Exception) -> None:
    reader, taken = read(Stream(5, error)), []
    with pytest.raises(type(error), match=str(error)):
        taken.extend(reader)
    assert len(taken) == 5
    reader.release()


def test_times_of_hours_and_spans_of_silence_are_kept() -> None:
    t = np.array([-5, 1 << 40], np.int64)
    flat = np.zeros(2, np.uint16)
    long = EventPacket(flat, flat, flat > 0, t, -10, (1 << 40) + 7, SIZE)
    reader = EventReader(iter([long, EventPacket.empty(5, 9, SIZE)]), Stream(0))
    first, second = (one.packet for one in reader)
    np.testing.assert_array_equal(first.t, t)
    assert (first.t_start_us, first.t_end_us, first.size) == (-10, (1 << 40) + 7, SIZE)
    assert (len(second), second.t_start_us, second.t_end_us) == (0, 5, 9)
    reader.release()


def stepping(count: int) -> Iterator[tuple[EventPacket, Any]]:
    for number in range(count):
        yield packet(number), number


def test_a_simulation_waits_for_its_user_and_tells_before_each_packet() -> None:
    beside: list[int] = []
    source = RemoteSource(partial(stepping, count=1_000), SIZE, beside.append)
    time.sleep(0.5)  # it has run ahead by now
    for number, found in enumerate(source):
        assert number in beside
        assert found.t_start_us == 10_000 * number
        if number == 0:
            assert len(beside) < 500
    assert len(beside) == 1_000
    source.close()


def all_of(camera: RingCamera) -> int:
    count = 0
    while (rows := camera.read(0.05)) is not None:
        count += len(rows[3])
    return count


def test_another_user_takes_the_same_events_and_knows_their_losses() -> None:
    stream = Stream(200, pause_s=0.002)
    reader = EventReader(stream, stream, new_ring(SIZE, share=NAME))
    camera = RingCamera.open(ADDRESS)
    before = reader.ring.weight
    assert all_of(camera) >= 20_000 - before - 100
    assert camera.losses["gap"] >= 60
    assert camera.losses["missed"] == 0
    assert len(camera.triggers) >= 60
    assert sum(len(one.packet) for one in reader) == 20_000
    camera.close()
    reader.release()


def test_what_is_not_shared_says_how_it_would_be() -> None:
    with pytest.raises(DeviceError, match="share=nobody"):
        RingCamera.open(Address.parse("ring:nobody"))
    with pytest.raises(ConfigError, match="letters, digits"):
        RingCamera.open(Address.parse("ring:../etc"))


def test_any_verbs_camera_is_shared_where_its_address_says_so(out: socket.socket) -> None:
    port_text = f"udp:127.0.0.1:0?encoding=evt2&share={NAME}"
    source = CameraSource(Address.parse(port_text), ReadOptions())
    camera = RingCamera.open(ADDRESS)
    for piece in datagrams(events(20_000))[:40]:
        out.sendto(piece, ("127.0.0.1", source.camera.port))  # type: ignore[attr-defined]
    taken, packets = 0, iter(source)
    while not taken:
        taken += len(next(packets))
    source.close()
    taken += sum(len(packet) for packet in packets)
    assert all_of(camera) >= taken > 0
    assert camera.size == (320, 320)
