"""RAW: headers, dispatch, time rules, each kind of damage word by word, streams as they come."""

import sys
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import ConfigError, DamageError, FormatError, RecordingError, SpikingTacError
from spikingtac.events import create_events, open_events
from spikingtac.events.evt.encode import Evt3Encoder
from spikingtac.events.evt.wire import BASE_X, VECT_8, VECT_12
from spikingtac.events.formats.file_source import FileSource
from spikingtac.types import EventPacket
from stand_ins.piped_camera import PipedCamera
from stand_ins.random_packets import (
    assert_equal,
    packet_at,
    packet_of,
    random_packet,
    save_events,
    whole,
)

HEAD3 = b"% evt 3.0\n% geometry 320x240\n% end\n"
HEAD2 = b"% evt 2.0\n% geometry 320x240\n% end\n"


def high3(value: int) -> int:
    return 0x8000 | value


def event3(low: int, x: int, y: int = 5, p: int = 1) -> list[int]:
    return [0x6000 | low, y, 0x2000 | p << 11 | x]


def high2(value: int) -> int:
    return 0x80000000 | value


def event2(low: int, x: int, y: int = 5, p: int = 1) -> int:
    return p << 28 | low << 22 | x << 11 | y


def opened(path: Path, head: bytes, words: list[int], kind: str, **options) -> FileSource:
    path.write_bytes(head + np.array(words, kind).tobytes())
    return open_events(path, **options)


def times(source: FileSource) -> list[int]:
    return [t for packet in source for t in packet.t.tolist()]


@pytest.fixture
def raw(tmp_path: Path):
    return lambda words, **options: opened(tmp_path / "a.raw", HEAD3, words, "<u2", **options)


def test_evt3_wraps_after_16_seconds(raw) -> None:
    source = raw([high3(4095), *event3(4095, 1), high3(0), *event3(0, 2)])
    assert times(source) == [(1 << 24) - 1, 1 << 24]
    assert dict(source.losses) == {}


def test_a_vector_moves_the_base_on_by_its_own_length(raw) -> None:
    """Sensors write 12 + 12 + 8 pixels, other writers any order."""
    source = raw([high3(1), 0x6000 | 7, 5, 0x3800 | 10, 0x5081, 0x5001, 0x4801, 0x4001])
    assert [x for packet in source for x in packet.x.tolist()] == [10, 17, 18, 26, 37, 38]


def test_a_restart_is_rebased_and_counted(raw) -> None:
    before = [w for h in range(1000, 1010) for w in (high3(h), *event3(7, 1))]
    source = raw(before + [w for h in range(10) for w in (high3(h), *event3(7, 2))])
    found = times(source)
    assert len(found) == 20
    assert found == sorted(found)
    assert found[10] - found[9] < 10
    assert found[19] - found[10] == 9 * 4096
    assert source.losses["time_reset"] == 1


def test_a_leap_of_2_24_us_is_taken_back(tmp_path: Path) -> None:
    leap = (1 << 24) >> 6
    words = [w for h in range(50) for w in (high2(h), event2(3, 1))]
    words += [w for h in range(50 + leap, 100 + leap) for w in (high2(h), event2(3, 1))]
    source = opened(tmp_path / "a.raw", HEAD2, words, "<u4")
    assert np.diff(times(source)).max() == 64
    assert source.losses["time_jump"] == 1


def test_a_lone_wrong_time_is_ignored(raw) -> None:
    words = [w for h in range(20) for w in (high3(h), *event3(7, 1))]
    words[4 * 9] ^= 1 << 10
    source = raw(words)
    assert times(source) == [(h << 12) + 7 for h in range(20)]
    assert source.losses["time_glitch"] == 1


def test_single_events_between_silences_keep_their_times(raw) -> None:
    found = times(raw([word for n in range(9) for word in (high3(400 * n), *event3(1, n))]))
    assert found == [400 * 4096 * n + 1 for n in range(9)]


def test_a_corrected_lower_time_stamps_nothing(raw) -> None:
    """The glitch of a real Gen 4.1: 799, event, 811, corrected to 800, event."""
    source = raw([high3(1), *event3(799, 1), 0x6000 | 811, *event3(800, 2), *event3(801, 3)])
    assert times(source) == [4096 + 799, 4096 + 800, 4096 + 801]
    assert dict(source.losses) == {"time_glitch": 1}


def test_events_outside_are_dropped(raw) -> None:
    vector = [0x3000 | 315, 0x4FFF, 0x4FFF, 0x50FF]
    source = raw([high3(0), *event3(1, 319), *event3(1, 320), *event3(2, 7, y=240), 5, *vector])
    assert sum(len(packet) for packet in source) == 1 + 5
    assert source.losses["out_of_range"] == 2 + 27
    assert max(int(packet.x.max()) for packet in source) == 319


def test_events_without_row_base_or_time_are_dropped(raw) -> None:
    source = raw([0x2001, high3(0), 0x2001, 0x4001, *event3(3, 9)])
    assert times(source) == [3]
    assert dict(source.losses) == {"missing_state": 3}


def test_words_that_are_no_events(raw) -> None:
    words = [high3(0), *event3(1, 1), 0x9999, 0x7001, 0xE014, 0xF123, 0x7004, 0xA301, 0x1000]
    source = raw([*words, *event3(2, 2)])
    assert times(source) == [1, 2]
    assert dict(source.losses) == {
        "padding": 1, "vendor_word": 4, "trigger": 1, "unknown_word": 1,
    }  # fmt: skip
    assert list(source.triggers) == [(1, 3, True)]


def test_strict_lets_harmless_words_pass_and_refuses_damage(raw) -> None:
    sound = [high3(0), *event3(1, 1), 0x9999, 0xA301]
    assert times(raw(sound, strict=True)) == [1]
    with pytest.raises(DamageError, match="unknown_word"):
        times(raw([*sound, 0xB000], strict=True))


def test_a_gap_is_seen_where_time_words_never_miss(tmp_path: Path) -> None:
    save_events(tmp_path / "a.raw", packet_at(range(200_000), (0, 200_000), (320, 240)))
    data = (tmp_path / "a.raw").read_bytes()
    (tmp_path / "a.raw").write_bytes(data[:200_000] + data[264_000:])
    source = open_events(tmp_path / "a.raw")
    assert len(times(source)) > 150_000
    assert source.losses["gap"] == 1
    # Until the next upper time, 256 us at most, lower times fall; they are held.
    assert set(source.losses) <= {"gap", "time_backwards"}
    assert source.losses["time_backwards"] <= 256


@pytest.mark.parametrize(("claimed", "actual"), [*permutations(["evt2", "evt21", "evt3"], 2)])
def test_a_wrong_header_is_refused_and_names_both(tmp_path: Path, claimed, actual) -> None:
    n = 20_000
    packet = random_packet(0, n, (320, 240))
    for encoding in (claimed, actual):
        save_events(tmp_path / f"{encoding}.raw", packet, encoding=encoding)
    files = [(tmp_path / f"{name}.raw").read_bytes() for name in (claimed, actual)]
    ends = [data.index(b"% end\n") + 6 for data in files]
    (tmp_path / "a.raw").write_bytes(files[0][: ends[0]] + files[1][ends[1] :])
    names = {"evt2": "EVT2", "evt21": r"EVT2\.1", "evt3": "EVT3"}
    with pytest.raises(FormatError, match=f"says {names[claimed]}.*are {names[actual]}"):
        open_events(tmp_path / "a.raw")
    assert len(times(open_events(tmp_path / "a.raw", encoding=actual))) == n


@pytest.mark.parametrize(
    ("lines", "size"),
    [
        (b"% evt 3.0\n% geometry 640x480\n", (640, 480)),
        (b"% format EVT3;height=720;width=1280\n", (1280, 720)),
        (b"% evt 3.0\n% geometry 0x0\n% Width 346\n% Height 260\n", (346, 260)),
    ],
)
def test_sizes_of_headers(tmp_path: Path, lines: bytes, size: tuple[int, int]) -> None:
    source = opened(tmp_path / "a.raw", lines, [high3(0), *event3(1, 1)], "<u2")
    assert (source.size, times(source)) == (size, [1])


def test_no_header_is_guessed_and_said(tmp_path: Path) -> None:
    words = [w for h in range(300) for w in (high3(h), *event3(7, 1))]
    source = opened(tmp_path / "a.raw", b"", words, "<u2")
    assert (source.format, source.size, len(times(source))) == ("EVT3", (320, 320), 300)
    assert len(source.notes) == 2
    table = np.column_stack([np.arange(0, 1_000_000, 700)] * 4) >> [0, 9, 13, 19]
    for dump in (np.random.default_rng(0).bytes(5_000), table.tobytes(), table.dumps()):
        (tmp_path / "b.raw").write_bytes(dump)
        with pytest.raises(FormatError, match="fit none of"):
            open_events(tmp_path / "b.raw")


@pytest.mark.parametrize("order", ["little", "legacy", "big"])
@pytest.mark.parametrize("told", [";endianness=", ";by="])
def test_byte_orders_of_evt21(tmp_path: Path, order: str, told: str) -> None:
    words = [high2(3) << 32, event2(5, 32) << 32 | 0b101, event2(6, 64) << 32 | 1]
    data = np.array(words, ">u8" if order == "big" else "<u8")
    if order == "legacy":
        data = data.view("<u4").reshape(-1, 2)[:, ::-1]
    head = f"% format EVT21;width=320;height=240{told}{order}\n% end\n".encode()
    (tmp_path / "a.raw").write_bytes(head + data.tobytes())
    packet = EventPacket.concatenate(list(open_events(tmp_path / "a.raw")))
    assert packet.x.tolist() == [32, 34, 64]
    assert packet.t.tolist() == [197, 197, 198]


def test_writers_refuse_what_does_not_fit(tmp_path: Path) -> None:
    def packet(t: list[int], x: int) -> EventPacket:
        column = np.full(len(t), x)
        return packet_of(np.array(t), column, column, column > 0, (320, 240))

    with create_events(tmp_path / "a.raw", (320, 240)) as writer:
        writer.write(packet([5], 1))
        for t, x in (([-4], 1), ([4], 1), ([9, 8], 1), ([9], 240), ([1 << 60], 1)):
            with pytest.raises(SpikingTacError, match=r"us came.* --shift-us|outside|split|fall"):
                writer.write(packet(t, x))
    with pytest.raises(FormatError, match="closed"):
        writer.write(packet([9], 1))
    for name, size, told in (
        ("b.raw", (4096, 16), "addresses"), ("b.aedat4", (40_000, 16), r"4 files \(at most 32768"),
        ("b.npz", (0, 0), "size is"), ("b.h5", (-3, 5), "size is"), ("b", (320.5, 240), "size is"),
    ):  # fmt: skip
        with pytest.raises(SpikingTacError, match=told):
            create_events(tmp_path / name, size)
    with pytest.raises(ConfigError, match="encoding"):
        open_events(tmp_path / "a.raw", encoding="evt5")
    assert times(open_events(tmp_path / "a.raw")) == [5]


def test_a_long_row_needs_one_base() -> None:
    """The decoder moves the base on by the vectors' 32 pixels: the next ones need none."""
    x = np.arange(10, 10 + 3 * 32, dtype=np.uint16)
    words = Evt3Encoder().encode(np.full(len(x), 5), x, np.full(len(x), 7, np.uint16), x > 0)
    assert (words >> 12).tolist()[-10:] == [BASE_X, *(3 * [VECT_12, VECT_12, VECT_8])]


SIZE = (320, 320)
EVENTS = 60_000


@pytest.fixture(params=["evt2", "evt21", "evt3"])
def stored(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    events = random_packet(3, EVENTS, SIZE, 13)
    return save_events(tmp_path / "whole.raw", events, encoding=request.param)


def test_a_pipe_gives_the_events_of_the_file(stored: Path, tmp_path: Path) -> None:
    camera = PipedCamera(tmp_path / "live", stored.read_bytes())
    source = open_events(tmp_path / "live")
    packets = list(source)
    camera.join()
    assert (source.size, source.format) == (SIZE, open_events(stored).format)
    assert_equal(EventPacket.concatenate(packets), whole(open_events(stored)))
    ends = [packet.t_end_us for packet in packets]
    assert ends[:-1] == [packet.t_start_us for packet in packets[1:]]
    with pytest.raises(RecordingError, match="only once"):
        list(source)


def test_events_come_before_the_stream_ends(stored: Path, tmp_path: Path) -> None:
    camera = PipedCamera(tmp_path / "live", stored.read_bytes())
    camera.pause_after(0.5)
    source = iter(open_events(tmp_path / "live"))
    got = 0
    while got < 0.45 * EVENTS:
        got += len(next(source))
    assert camera.written < 0.6 * stored.stat().st_size
    camera.go_on.set()
    got += sum(len(packet) for packet in source)
    assert got == EVENTS


def test_standard_input_is_a_stream(stored: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with stored.open("rb") as file:
        monkeypatch.setattr(sys, "stdin", file)
        assert_equal(whole(open_events("-")), whole(open_events(stored)))


@pytest.mark.parametrize("head", [b"% end\n", b""])
def test_a_stream_without_a_size_is_refused(head: bytes, stored: Path, tmp_path: Path) -> None:
    PipedCamera(tmp_path / "live", head + stored.read_bytes().partition(b"% end\n")[2])
    with pytest.raises(FormatError, match="names encoding and size"):
        open_events(tmp_path / "live")
