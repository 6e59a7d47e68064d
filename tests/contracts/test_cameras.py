"""One suite that every camera must pass against its counterpart: read, silence, health, goodbye."""

import json
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import CameraLostError, ConfigError, RecordingError
from spikingtac.events.camera import Address, Camera, is_address, open_camera
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.formats.file_source import ReadOptions
from spikingtac.events.formats.packing import ColumnCheck
from spikingtac.events.open import open_events
from spikingtac.types import EventPacket
from stand_ins.camera_counterparts import COUNTERPARTS, Counterpart, events

WAIT_S = 20.0
POLL_S = 0.05


@pytest.fixture(params=list(COUNTERPARTS))
def wired(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Counterpart]:
    with ExitStack() as opened:
        yield COUNTERPARTS[request.param](opened, tmp_path)


def read(camera: Camera, count: int) -> EventPacket:
    """Read until so many events are here; mend the columns of a camera that leaves it to us."""
    check = ColumnCheck(camera.size, camera.losses)
    parts: list[EventPacket] = []
    until_s = time.monotonic() + WAIT_S
    while sum(map(len, parts)) < count and time.monotonic() < until_s:
        rows = camera.read(POLL_S)
        if rows is None:
            break
        x, y, p, t = rows if camera.checked else check(*rows)
        if len(t):
            columns = (x.copy(), y.copy(), p.copy(), t.copy())
            parts.append(EventPacket(*columns, int(t[0]), int(t[-1]) + 1, camera.size))
    assert parts, "nothing arrived"
    return EventPacket.concatenate(parts)


def test_what_is_sent_arrives(wired: Counterpart) -> None:
    for sent in (events(), events(1_000, first_us=5_000, seed=1)):
        wired.sender(sent)
        found = read(wired.camera, len(sent))
        for column in ("x", "y", "p"):
            np.testing.assert_array_equal(getattr(found, column), getattr(sent, column))
        np.testing.assert_array_equal(np.diff(found.t), np.diff(sent.t))
    assert {kind: count for kind, count in wired.camera.losses.kinds() if count} == {}


def test_silence_is_no_event_and_no_end(wired: Counterpart) -> None:
    for _ in range(3):
        rows = wired.camera.read(0.01)
        assert rows is not None
        assert len(rows[3]) == 0


def test_it_describes_itself(wired: Counterpart) -> None:
    assert wired.camera.size == (320, 320)
    json.dumps(wired.camera.describe())
    assert all(isinstance(value, int) for value in wired.camera.biases().values())
    windows = wired.camera.roi()
    json.dumps(windows)
    told = {"prophesee": [[8, 16, 300, 280]]}
    kind = Address.parse(wired.address).kind
    assert windows == told.get(kind, windows)
    assert all(len(window) == 4 for window in windows)


def test_it_closes_twice(wired: Counterpart) -> None:
    wired.camera.close()
    wired.camera.close()


def test_it_says_goodbye_as_its_protocol_can(wired: Counterpart) -> None:
    wired.leave()
    until_s = time.monotonic() + (WAIT_S if wired.ends != "silence" else 0.2)
    told = "silence"
    while told == "silence" and time.monotonic() < until_s:
        try:
            told = "silence" if wired.camera.read(POLL_S) is not None else "end"
        except CameraLostError:
            told = "lost"
    assert told == wired.ends


def test_unknown_options_are_refused_with_the_nearest(wired: Counterpart) -> None:
    address = Address.parse(wired.address)
    wrong = Address(kind=address.kind, target=address.target, options={"secnds": "1"})
    with pytest.raises(ConfigError, match="did you mean 'seconds'"):
        open_camera(wrong)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("upd:7777", "did you mean 'udp'"),
        ("udp:x", "PORT"),
        ("udp:70000", "65535"),
        ("udp:0?encoding=evt4", "did you mean 'evt"),
        ("udp:0?size=320", "WIDTHxHEIGHT"),
        ("udp:0?size", "name=value"),
        ("udp:0?size=1x1&size=2x2", "name=value"),
        ("udp:0?=1", "name=value"),
        ("udp:0?seconds=-1", "number from"),
        ("udp:0?encoding=evt3&order=big", "EVT2.1"),
        ("openmv:/dev/ttyACM0?words=3000", "power of two"),
        ("twin:no-such-scene", "no-such-scene"),
        ("twin:", "name of a scene"),
        ("pipe:missing.raw", "mkfifo"),
    ],
)
def test_wrong_addresses_say_what_is_valid(text: str, told: str) -> None:
    with pytest.raises(Exception, match=told) as caught:
        CameraSource(Address.parse(text), ReadOptions())
    assert caught.type.__module__ == "spikingtac.errors"


def test_an_address_is_taken_apart_and_put_together() -> None:
    text = "udp:7777?encoding=evt2&size=320x320"
    address = Address.parse(text)
    assert (address.kind, address.target) == ("udp", "7777")
    assert address.size("size") == (320, 320)
    assert str(address) == text
    assert Address.parse("nd:").target == ""


def test_files_are_no_addresses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for text in ("events.raw", "C:\\data\\a.raw", "-", "https://host/a.raw", "a"):
        assert not is_address(text)
    with pytest.raises(RecordingError, match="there is no file"):
        open_events("https://example.org/a.raw")
    monkeypatch.chdir(tmp_path)
    assert is_address("udp:7777")
    Path("udp:7777").write_bytes(b"")
    assert not is_address("udp:7777")
