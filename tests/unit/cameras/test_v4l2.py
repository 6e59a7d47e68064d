"""Frames of the Raspberry Pi's driver: each encoding's mark, cuts, other sizes, the device."""

import os
import threading
from pathlib import Path

import numpy as np
import pytest

from spikingtac.cameras.v4l2 import FRAME, READ_BYTES
from spikingtac.errors import DeviceError
from spikingtac.events.camera import Address, open_camera
from spikingtac.events.evt.encode import ENCODERS
from spikingtac.events.open import open_events
from spikingtac.types import EventPacket
from stand_ins.camera_counterparts import END_MARKS, events

FRAME_BYTES = FRAME[0] * FRAME[1]


def frames(packets: list[EventPacket], encoding: str) -> bytes:
    """Return frames as the driver fills them: words, the mark, and what an earlier frame left."""
    encoder = ENCODERS[encoding]()
    rest = np.random.default_rng(0).bytes(FRAME_BYTES)
    data = b""
    for packet in packets:
        words = encoder.encode(packet.t, packet.x, packet.y, packet.p).tobytes()
        end = END_MARKS[encoding]
        data += words + end + rest[len(words) + len(end) :]
    return data


def bursts() -> list[EventPacket]:
    return [events(2_000, first_us=1_000 + 3_000 * n, seed=n) for n in range(3)]


@pytest.mark.parametrize("encoding", list(END_MARKS))
def test_a_dump_gives_the_events_before_each_mark(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "dump.raw"
    path.write_bytes(frames(bursts(), encoding))
    source = open_events(f"v4l2:{path}?encoding={encoding}")
    found = EventPacket.concatenate(list(source))
    sent = EventPacket.concatenate(bursts())
    for column in ("x", "y", "p"):
        np.testing.assert_array_equal(getattr(found, column), getattr(sent, column))
    np.testing.assert_array_equal(found.t - found.t[0], sent.t - sent.t[0])
    assert source.losses["no_end_mark"] == source.losses["garbage"] == 0


def test_events_are_given_out_with_the_mark_before_the_frame_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What follows the mark is left out whenever it comes, and the next frame begins behind it."""
    first, second = (frames([packet], "evt2") for packet in bursts()[:2])
    tool, pipe = tmp_path / "v4l2-ctl", tmp_path / "frames"
    os.mkfifo(pipe)
    tool.write_text(f"#!/bin/sh\nexec cat {pipe}\n")
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    camera = open_camera(Address.parse("v4l2:/dev/null?encoding=evt2"))
    with pipe.open("wb", buffering=0) as writer:
        writer.write(first[:READ_BYTES])
        rows = camera.read(5.0)
        assert len(rows[3]) == 2_000
        rest = threading.Thread(target=writer.write, args=(first[READ_BYTES:] + second,))
        rest.start()
        rows = camera.read(5.0)
        np.testing.assert_array_equal(rows[0], bursts()[1].x)
        camera.close()
        rest.join(10.0)


def test_a_frame_without_a_mark_and_a_cut_dump_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "dump.raw"
    path.write_bytes(frames(bursts(), "evt2")[: 2 * FRAME_BYTES + 4_000])
    source = open_events(f"v4l2:{path}?encoding=evt2")
    found = sum(len(packet) for packet in source)
    assert 4_000 < found < 6_000
    assert source.losses["truncated"] == 1
    assert source.losses["no_end_mark"] == 1


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DeviceError, match="dtoverlay"):
        open_camera(Address.parse("v4l2:/dev/video99"))
    monkeypatch.setenv("PATH", "")
    with pytest.raises(DeviceError, match="v4l-utils"):
        open_camera(Address.parse("v4l2:/dev/null"))
