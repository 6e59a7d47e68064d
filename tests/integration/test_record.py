"""``record`` over real sockets: every event on disk or counted, whatever happens to the process."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import CameraLostError, ConfigError, RecordingError
from spikingtac.events import camera_source
from spikingtac.events.camera import Address, Camera
from spikingtac.events.camera_source import CameraSource, WhenLost
from spikingtac.events.formats.file_source import ReadOptions, Rows
from spikingtac.events.open import open_events
from spikingtac.events.recording import Recording
from spikingtac.robot.guard_loop import stream_arrivals
from spikingtac.stream.packets import RingCamera
from spikingtac.stream.pair import live_pair
from spikingtac.stream.record import parse_split, prepare_folder, record
from spikingtac.stream.recorder import Recorder
from spikingtac.types import EventPacket
from stand_ins.camera_counterparts import SIZE, datagrams, events, free_port
from stand_ins.verbs import Verbs
from stand_ins.waiting import PATIENCE_S, wait_until

pytestmark = pytest.mark.waits

COMMAND = Path(sys.executable).with_name("spikingtac")


def start(folder: Path, port: int, *more: object) -> subprocess.Popen[str]:
    """Start the verb, and wait until it listens."""
    address = f"udp:127.0.0.1:{port}?encoding=evt2&size=320x320"
    given = [str(COMMAND), "record", address, "-o", str(folder), "--json", *map(str, more)]
    pipe = subprocess.PIPE
    process = subprocess.Popen(given, stdout=pipe, stderr=pipe, text=True)
    wait_until(lambda: (folder / "manifest.json").exists() or process.poll() is not None)
    assert process.poll() is None, process.communicate()
    return process


def send(out: socket.socket, port: int, packets: list[EventPacket]) -> None:
    for packet in packets:
        for datagram in datagrams(packet):
            out.sendto(datagram, ("127.0.0.1", port))
        time.sleep(0.005)


def bursts(count: int) -> list[EventPacket]:
    return [events(2_000, first_us=1_000 + 5_000 * number, seed=number) for number in range(count)]


def whole(folder: Path) -> EventPacket:
    return EventPacket.concatenate(list(open_events(folder)))


def readable(folder: Path) -> int:
    try:
        return len(whole(folder))
    except RecordingError:  # a file that has just begun is empty
        return 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_completes_a_recording_in_parts(
    tmp_path: Path, number: int, out: socket.socket
) -> None:
    folder, port = tmp_path / "rec", free_port()
    process = start(folder, port, "--split", "0.05s")
    sent = bursts(40)
    send(out, port, sent)
    wait_until(lambda: readable(folder) == 80_000)
    process.send_signal(number)
    document, error = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, error
    told = json.loads(document)
    assert (told["ended"], told["events"], told["lost_events"]) == ("closed", 80_000, 0)
    assert told["files"] >= 2
    assert {told["health"][key] for key in ("gaps", "overflows", "damaged", "reconnects")} == {0}
    found, expected = whole(folder), EventPacket.concatenate(sent)
    for column in ("x", "y", "p"):
        np.testing.assert_array_equal(getattr(found, column), getattr(expected, column))
    np.testing.assert_array_equal(found.t - found.t[0], expected.t - expected.t[0])
    manifest = Recording.open(folder).manifest
    assert manifest["complete"] is True
    assert manifest["health"] == told["health"]
    for part in manifest["files"]:
        assert hashlib.sha256((folder / part["name"]).read_bytes()).hexdigest() == part["sha256"]
    assert not list(folder.glob(".*"))


class Flaky(Camera):
    """A camera that is unplugged after some packets, and plugged in again later."""

    checked = True
    opened = closed = 0
    plugged = True

    def __init__(self) -> None:
        super().__init__()
        self.size = SIZE
        type(self).opened += 1
        self._left = [events(500, first_us=1_000 * n, seed=n) for n in range(1, 4)]

    @classmethod
    def open(cls, address: Address) -> Flaky:
        if not cls.plugged:
            raise CameraLostError("not plugged in")
        return cls()

    def read(self, timeout_s: float) -> Rows | None:
        if not self._left:
            type(self).plugged = False
            raise CameraLostError("unplugged")
        packet = self._left.pop(0)
        return packet.x, packet.y, packet.p, packet.t

    def close(self) -> None:
        type(self).closed += 1


@pytest.fixture
def flaky(monkeypatch: pytest.MonkeyPatch) -> type[Flaky]:
    Flaky.opened, Flaky.closed, Flaky.plugged = 0, 0, True
    monkeypatch.setattr(camera_source, "open_camera", Flaky.open)
    return Flaky


def test_an_unplugged_camera_comes_back_with_time_that_goes_on(
    flaky: type[Flaky], tmp_path: Path
) -> None:
    source = CameraSource(Address.parse("flaky:"), ReadOptions(), when_lost="reconnect")
    prepare_folder(tmp_path / "rec", overwrite=False)
    looks = 0

    def plug_in_again(_: object) -> None:
        nonlocal looks
        looks += 1
        flaky.plugged = flaky.plugged or looks > 1
        if flaky.opened == 2:
            source.close()

    told = record([source], tmp_path / "rec", seconds=20.0, show=plug_in_again)
    assert told["losses"]["reconnected"] == 1
    assert told["delivery"]["reconnects"] == 1
    (gap,) = told["gaps"]
    found = whole(tmp_path / "rec")
    assert len(found) == told["events"] == told["received_events"]
    assert (np.diff(found.t) >= 0).all()
    assert gap["t_to_us"] - gap["t_from_us"] > 100_000
    assert np.diff(found.t).max() == pytest.approx(gap["t_to_us"] - gap["t_from_us"], abs=2)


class FlakyWithTriggers(Flaky):
    """With a trigger edge 100 us before the first event of each packet; it comes back at once."""

    @classmethod
    def open(cls, address: Address) -> Flaky:
        return cls()

    def read(self, timeout_s: float) -> Rows | None:
        found = super().read(timeout_s)
        if found is not None:
            self.triggers.append(int(found[3][0]) - 100, 0, True)
        return found


def test_trigger_edges_go_on_with_the_events_after_an_unplugged_camera_came_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    FlakyWithTriggers.opened = 0
    monkeypatch.setattr(camera_source, "open_camera", FlakyWithTriggers.open)
    source = CameraSource(Address.parse("flaky:"), ReadOptions(), when_lost="reconnect")
    first_us = []
    for *_, t in source.columns():
        first_us.append(int(t[0]))
        if len(first_us) == 6:
            source.close()
    assert FlakyWithTriggers.opened == 2
    assert source.triggers.t_us.tolist() == [t_us - 100 for t_us in first_us]


def test_trigger_edges_of_a_paired_camera_reach_those_that_it_is_shared_with(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(camera_source, "open_camera", FlakyWithTriggers.open)
    options, name = ReadOptions(), f"pair{os.getpid()}"
    cameras = [CameraSource(Address.parse(f"flaky:?share={name}"), options)]
    paired = live_pair([*cameras, CameraSource(Address.parse("flaky:"), options)], options)[0]
    columns = paired.columns()
    next(columns)
    other = RingCamera.open(Address.parse(f"ring:{name}"))
    assert len(list(columns)) == 2
    while other.read(0.1) is not None:
        pass
    other.close()
    assert (len(paired.triggers), len(other.triggers)) == (3, 2)


def test_a_lost_camera_ends_a_stream_or_raises_for_a_robot(flaky: type[Flaky]) -> None:
    source = CameraSource(Address.parse("flaky:"), ReadOptions())
    assert sum(len(packet) for packet in source) == 1_500
    assert (source.ended, source.losses["disconnected"]) == ("lost", 1)
    flaky.plugged = True
    with pytest.raises(CameraLostError):
        list(stream_arrivals("flaky:"))
    assert flaky.opened == flaky.closed == 2  # once for each, and not again


@pytest.mark.parametrize(("when_lost", "moved"), [("reconnect", 1), ("raise", 0)])
def test_a_restart_takes_its_time_unless_a_guard_has_to_see_it(
    flaky: type[Flaky], when_lost: WhenLost, moved: int
) -> None:
    source = CameraSource(Address.parse("flaky:"), ReadOptions(), when_lost)
    columns = source.columns()
    before_us = next(columns)[3][-1]
    time.sleep(0.3)
    source.camera.losses.add("time_reset")
    assert (next(columns)[3][0] - before_us >= 300_000) == len(source.gaps) == moved


class Steady(Flaky):
    """A camera that sends 40 packets, and goes on whether anybody takes them."""

    plugged = True

    def __init__(self) -> None:
        super().__init__()
        self._left = [events(2_000, first_us=5_000 * (n + 1), seed=n) for n in range(40)]

    def read(self, timeout_s: float) -> Rows | None:
        return super().read(timeout_s) if self._left else None


def test_a_slow_disk_loses_nothing_in_silence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The writer is held up; memory is bounded, and each event is on disk or counted."""
    monkeypatch.setattr(camera_source, "open_camera", Steady.open)
    monkeypatch.setattr("spikingtac.stream.recorder.ROOM_BYTES", 9 * 10_000)
    write = Recorder.write
    monkeypatch.setattr(Recorder, "write", lambda *given: (time.sleep(0.2), write(*given))[1])
    source = CameraSource(Address.parse("steady:"), ReadOptions())
    prepare_folder(tmp_path / "rec", overwrite=False)
    told = record([source], tmp_path / "rec")
    assert told["lost_events"] > 0
    assert told["events"] + told["lost_events"] == told["received_events"] == 80_000
    assert len(whole(tmp_path / "rec")) == told["events"]


def test_a_recording_is_replaced_only_by_a_camera_that_is_there(
    tmp_path: Path, verbs: Verbs
) -> None:
    folder = tmp_path / "rec"
    folder.mkdir()
    (folder / "events.raw").write_bytes(b"old")
    given = "record", f"pipe:{tmp_path / 'missing'}", "-o"
    told = verbs.said(*given, folder, code=2)  # at once, before the camera is waited for
    assert "--overwrite" in told
    verbs.said(*given, folder, "--overwrite", code=3)
    assert (folder / "events.raw").read_bytes() == b"old"
    verbs.said(*given, tmp_path / "new", code=3)
    assert not (tmp_path / "new").exists()


def test_what_cannot_be_recorded_says_what_to_do(tmp_path: Path, verbs: Verbs) -> None:
    with pytest.raises(ConfigError, match="60s"):
        parse_split("often")
    assert parse_split("2GB")[0] == 2e9
    told = verbs.said("record", tmp_path / "a.raw", "-o", tmp_path / "rec", code=2)
    assert "no camera" in told


@pytest.mark.parametrize("ending", [b"% end\n", b""])
def test_standard_input_needs_no_end_of_its_header(ending: bytes, tmp_path: Path) -> None:
    words = b"".join(datagrams(events(2_000, first_us=1_000), "evt3"))
    data = b"% evt 3.0\n% geometry 320x320\n" + ending + words
    given = [str(COMMAND), "record", "-", "-o", str(tmp_path / "rec"), "--json"]
    done = subprocess.run(given, input=data, capture_output=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["events"] == 2_000


def test_info_shows_what_the_manifest_tells(
    tmp_path: Path, verbs: Verbs, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera_source, "open_camera", Steady.open)
    source = CameraSource(Address.parse("steady:"), ReadOptions())
    source.losses.add("overflow", 7)
    record([source], tmp_path)
    path = tmp_path / "manifest.json"
    path.write_text(path.read_text().replace('"events": 80000', '"events": 80001'))
    told = verbs.told("info", tmp_path)
    assert (told["events"], told["manifest_events"]) == (80_000, 80_001)
    assert told["recorded_losses"] == {"overflow": 7}
    assert "the manifest tells 80001 events" in verbs.err
    assert "sha256" not in verbs.err
    (tmp_path / "events.raw").write_bytes(
        (tmp_path / "events.raw").read_bytes() + bytes(2)
    )  # a word without an event
    verbs.told("info", tmp_path)
    assert "events.raw is not what was recorded" in verbs.err


def test_an_input_that_is_empty_ends_a_recording(tmp_path: Path) -> None:
    given = [str(COMMAND), "record", "-", "-o", str(tmp_path / "rec")]
    done = subprocess.run(given, input=b"", capture_output=True, timeout=PATIENCE_S)
    assert (done.returncode, b"before a RAW header came" in done.stderr) == (1, True)
