"""One suite that every format must pass: write, read back, read again, cut, empty, truncated."""

import hashlib
from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import ConfigError, DamageError, FormatError, RecordingError
from spikingtac.events import EventSource, create_events, open_events
from spikingtac.types import EventPacket
from stand_ins.random_packets import assert_equal, packet_of, random_packet, whole

SIZE = (320, 240)
FORMATS = [
    pytest.param("a.raw", "evt2", id="evt2"),
    pytest.param("a.raw", "evt21", id="evt21"),
    pytest.param("a.raw", "evt3", id="evt3"),
    *(pytest.param(f"a.{end}", None, id=end) for end in ("npz", "csv", "h5", "aedat4")),
]
every_format = pytest.mark.parametrize(("name", "encoding"), FORMATS)


def sample(n: int = 5_000, first_us: int = 70) -> EventPacket:
    return random_packet(n, n, SIZE, 17, first_us)


def write(path: Path, encoding: str | None, packets: list[EventPacket]) -> None:
    with create_events(path, SIZE, encoding=encoding) as writer:
        for packet in packets:
            writer.write(packet)
    writer.close()  # a second time does nothing


@every_format
@pytest.mark.parametrize("chunk_events", [1, 7, 999, 1 << 17])
def test_what_is_written_is_read_in_packets_of_any_length_and_again(
    tmp_path: Path, name: str, encoding: str | None, chunk_events: int
) -> None:
    write(tmp_path / name, encoding, [sample(600)])
    source = open_events(tmp_path / name, strict=True, chunk_events=chunk_events)
    assert isinstance(source, EventSource)
    assert source.size == SIZE
    for _ in range(2):
        assert_equal(whole(source), sample(600))
        assert dict(source.losses) == {}
    assert max(len(packet) for packet in source) <= chunk_events + 5  # equal times stay together


@every_format
def test_what_lies_outside_of_the_sensor_is_not_written(
    tmp_path: Path, name: str, encoding: str | None
) -> None:
    with create_events(tmp_path / name, (160, 160), encoding=encoding) as writer:
        with pytest.raises(FormatError, match="outside of the sensor of 160x160 px; crop"):
            writer.write(sample())
        writer.write(random_packet(1, 9, (160, 160)))
    assert len(whole(open_events(tmp_path / name))) == 9


@every_format
def test_bytes_do_not_depend_on_the_cuts_or_the_clock(
    tmp_path: Path, name: str, encoding: str | None
) -> None:
    packet = sample()
    cuts = [
        packet.part(first, first + 613, 0, packet.t_end_us) for first in range(0, len(packet), 613)
    ]
    (tmp_path / "whole").mkdir()
    write(tmp_path / "whole" / name, encoding, [packet])
    write(tmp_path / name, encoding, [*cuts, EventPacket.empty(0, 0, SIZE)])
    assert (tmp_path / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


@every_format
def test_no_events_and_times_beyond_the_counters(
    tmp_path: Path, name: str, encoding: str | None
) -> None:
    write(tmp_path / name, encoding, [])
    source = open_events(tmp_path / name)
    assert len(whole(source)) == 0
    assert source.size in (SIZE, (320, 320))
    first_us = (1 << 35) + (1 << 24) + 12_345
    write(tmp_path / name, encoding, [sample(300, first_us)])
    assert_equal(whole(open_events(tmp_path / name)), sample(300, first_us))


@pytest.mark.parametrize(("name", "encoding"), [f for f in FORMATS if f.id not in ("h5", "npz")])
def test_a_cut_keeps_every_whole_event(tmp_path: Path, name: str, encoding: str | None) -> None:
    write(tmp_path / name, encoding, [sample()])
    data = (tmp_path / name).read_bytes()
    cut_words = 0
    for length in range(len(data) * 3 // 4, len(data) * 3 // 4 + 5):
        (tmp_path / name).write_bytes(data[:length])
        source = open_events(tmp_path / name)
        found = whole(source)
        kept = len(found) - (name == "a.csv")  # a number that was cut is a number
        assert_equal(found.part(0, kept, 0, 0), sample().part(0, kept, 0, 0))
        assert len(found) > 0.7 * len(sample())
        if source.losses["truncated"]:
            cut_words += 1
            with pytest.raises(DamageError, match="truncated"):
                whole(open_events(tmp_path / name, strict=True))
    assert cut_words >= 2 or name == "a.csv"


@pytest.mark.parametrize("ending", ["h5", "npz"])
def test_a_cut_archive_is_refused(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"a.{ending}"
    write(path, None, [sample()])
    path.write_bytes(path.read_bytes()[:2_000])
    with pytest.raises(FormatError, match="no readable"):
        whole(open_events(path))


def test_an_empty_file(tmp_path: Path) -> None:
    (tmp_path / "a.bag").write_bytes(b"")
    with pytest.raises(RecordingError, match=r"a\.bag.*is empty"):
        open_events(tmp_path / "a.bag")


def test_unknown_names_are_refused_with_the_nearest(tmp_path: Path) -> None:
    (tmp_path / "a.h6").write_bytes(b"x")
    with pytest.raises(FormatError, match=r"did you mean '\.h5'"):
        open_events(tmp_path / "a.h6")
    with pytest.raises(ConfigError, match="did you mean 'npz'"):
        create_events(tmp_path / "a.np", SIZE)
    with pytest.raises(ConfigError, match="did you mean 'evt3'"):
        create_events(tmp_path / "a.raw", SIZE, encoding="evt33")
    with pytest.raises(RecordingError, match="no file"):
        open_events(tmp_path / "missing.raw")
    with pytest.raises(RecordingError, match=r"holds no events\.raw"):
        open_events(tmp_path)


# A change here is a change of format: say so in the changelog.
DIGESTS = {
    "evt2": "dd0a2be8f66db109", "evt21": "28cfae0d91b595f9", "evt3": "073e836c66ac5ca8",
    "npz": "c16b46f6893ab740", "csv": "5eaebf4a9ffd23bd", "aedat4": "ddbeae9d60bf7f9c",
}  # fmt: skip


@pytest.mark.parametrize("kind", DIGESTS)
def test_the_same_events_give_the_same_bytes_in_every_version(tmp_path: Path, kind: str) -> None:
    index = np.arange(4_000)  # vectors, ties, wraps and silence, from arithmetic alone
    t = index // 7 * 3 + (index // 1_000) * 9_000_000
    packet = packet_of(t, (index * 3) % 320, (index // 7) % 240, (index // 40) % 3 > 0, SIZE)
    encoding = kind if kind.startswith("evt") else None
    path = tmp_path / f"a.{'raw' if encoding else kind}"
    write(path, encoding, [packet])
    assert hashlib.sha256(path.read_bytes()).hexdigest()[:16] == DIGESTS[kind]
