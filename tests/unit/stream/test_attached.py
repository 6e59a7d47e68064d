"""A user of another reader's ring: it takes what comes, and is told what it missed and lost."""

from __future__ import annotations

import os
import time

import pytest

from spikingtac.errors import ConfigError, DeviceError
from spikingtac.events.address import Address
from spikingtac.stream.packets import new_ring
from spikingtac.stream.reader import EventReader
from spikingtac.stream.sources import RingCamera
from stand_ins.packets import SIZE, Stream

NAME = f"test-{os.getpid()}"
ADDRESS = Address.parse(f"ring:{NAME}")


def all_of(camera: RingCamera) -> int:
    count = 0
    while (rows := camera.read(0.05)) is not None:
        count += len(rows[3])
    return count


def test_another_user_takes_the_same_events_and_knows_their_losses() -> None:
    stream = Stream(200, pause_s=0.002)
    reader = EventReader.in_thread(stream, stream, new_ring(SIZE, share=NAME))
    camera = RingCamera.open(ADDRESS)
    before = reader.ring.weight
    assert all_of(camera) >= 20_000 - before - 100
    assert camera.losses["gap"] >= 60
    assert camera.losses["missed"] == 0
    assert len(camera.triggers) >= 60
    assert sum(len(one.packet) for one in reader) == 20_000
    camera.close()
    reader.release()


def test_a_user_that_is_too_slow_is_told_what_it_missed() -> None:
    stream = Stream(300, pause_s=0.001)
    reader = EventReader.in_thread(stream, stream, new_ring(SIZE, 20_000, NAME))
    camera = RingCamera.open(Address.parse(f"ring:{NAME}?late=60"))
    before = reader.ring.weight
    while not reader.ended:
        time.sleep(0.01)
    taken = all_of(camera)
    assert camera.losses["missed"] > 0
    assert taken + camera.losses["missed"] == 30_000 - before
    reader.release()


def test_a_user_that_is_late_goes_on_with_the_newest_events() -> None:
    stream = Stream(300, pause_s=0.001)
    reader = EventReader.in_thread(stream, stream, new_ring(SIZE, share=NAME))
    camera = RingCamera.open(Address.parse(f"ring:{NAME}?late=0.1"))
    before = reader.ring.weight
    while not reader.ended:
        time.sleep(0.01)
    time.sleep(0.2)
    taken = all_of(camera)
    assert 0 < taken < 1_000
    assert taken + camera.losses["missed"] == 30_000 - before
    reader.release()


def test_what_is_not_shared_says_how_it_would_be() -> None:
    with pytest.raises(DeviceError, match="share=nobody"):
        RingCamera.open(Address.parse("ring:nobody"))
    with pytest.raises(ConfigError, match="letters, digits"):
        RingCamera.open(Address.parse("ring:../etc"))
