"""RAW as it comes: pipes give the file's events, at once, and once."""

import sys
from pathlib import Path

import pytest

from spikingtac.errors import FormatError, RecordingError
from spikingtac.events import create_events, open_events
from spikingtac.types import EventPacket
from stand_ins.piped_camera import PipedCamera
from stand_ins.random_packets import assert_equal, random_packet, whole

SIZE = (320, 320)
EVENTS = 60_000


@pytest.fixture(params=["evt2", "evt21", "evt3"])
def raw(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / "whole.raw"
    with create_events(path, SIZE, encoding=request.param) as writer:
        writer.write(random_packet(3, EVENTS, SIZE, 13))
    return path


def without_header(data: bytes) -> bytes:
    return data.partition(b"% end\n")[2]


def test_a_pipe_gives_the_events_of_the_file(raw: Path, tmp_path: Path) -> None:
    camera = PipedCamera(tmp_path / "live", raw.read_bytes())
    source = open_events(tmp_path / "live")
    packets = list(source)
    camera.join()
    assert (source.size, source.format) == (SIZE, open_events(raw).format)
    assert_equal(EventPacket.concatenate(packets), whole(open_events(raw)))
    ends = [packet.t_end_us for packet in packets]
    assert ends[:-1] == [packet.t_start_us for packet in packets[1:]]
    with pytest.raises(RecordingError, match="only once"):
        list(source)


def test_events_come_before_the_stream_ends(tmp_path: Path) -> None:
    path = tmp_path / "whole.raw"
    with create_events(path, SIZE) as writer:
        writer.write(random_packet(3, EVENTS, SIZE, 13))
    camera = PipedCamera(tmp_path / "live", path.read_bytes())
    camera.pause_after(0.5)
    source = iter(open_events(tmp_path / "live"))
    got = 0
    while got < 0.45 * EVENTS:
        got += len(next(source))
    assert camera.written < 0.6 * path.stat().st_size
    camera.go_on.set()
    got += sum(len(packet) for packet in source)
    assert got == EVENTS


def test_standard_input_is_a_stream(raw: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with raw.open("rb") as file:
        monkeypatch.setattr(sys, "stdin", file)
        assert_equal(whole(open_events("-")), whole(open_events(raw)))


@pytest.mark.parametrize("head", [b"% end\n", b""])
def test_a_stream_without_a_size_is_refused(head: bytes, raw: Path, tmp_path: Path) -> None:
    PipedCamera(tmp_path / "live", head + without_header(raw.read_bytes()))
    with pytest.raises(FormatError, match="names encoding and size"):
        open_events(tmp_path / "live")
