"""Two fingers on one time base: recorded, read back, tracked, and aligned by one line."""

import itertools
import socket
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from spikingtac.events.camera import Address
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.formats.file_source import ReadOptions
from spikingtac.events.open import open_events
from spikingtac.events.recording import Recording
from spikingtac.stream.pair import live_pair
from spikingtac.stream.record import prepare_folder, record
from spikingtac.tracks import Tracks
from spikingtac.types import EventPacket
from stand_ins.camera_counterparts import SIZE, datagrams
from stand_ins.random_packets import save_events
from stand_ins.verbs import Verbs
from stand_ins.viewer import CirclingDots, open_circling

pytestmark = pytest.mark.waits

LATER_US = 7_000_000  # The second sensor's clock is ahead of the first one's by so much.
BURSTS, PERIOD_S = 40, 0.02
FAST = "--preset", "fast", "--rate-hz", "1000"


def burst(number: int, shift_us: int) -> EventPacket:
    """200 events at one column, which tells the burst."""
    t = shift_us + 1_000 + round(number * PERIOD_S * 1e6) + np.arange(200, dtype=np.int64)
    x, y = np.full(200, number, np.uint16), np.arange(200, dtype=np.uint16)
    return EventPacket(x, y, x % 2 == 0, t, int(t[0]), int(t[-1]) + 1, SIZE)


def send(out: socket.socket, number: int, cameras: Sequence[tuple[CameraSource, int]]) -> None:
    """Send a burst to cameras at once, each on a clock of its own."""
    for source, shift_us in cameras:
        for datagram in datagrams(burst(number, shift_us)):
            out.sendto(datagram, ("127.0.0.1", source.camera.port))  # type: ignore[attr-defined]


def send_both(out: socket.socket, sources: Sequence[CameraSource]) -> None:
    """Send each burst to both cameras as time passes."""
    begun_s = time.monotonic()
    for number in range(BURSTS):
        time.sleep(max(begun_s + number * PERIOD_S - time.monotonic(), 0.0))
        send(out, number, [*zip(sources, (0, LATER_US), strict=True)])


def two_cameras() -> list[CameraSource]:
    address = Address.parse("udp:127.0.0.1:0?encoding=evt2&size=320x320")
    return [CameraSource(address, ReadOptions()) for _ in range(2)]


def burst_times(packets: Sequence[EventPacket]) -> dict[int, int]:
    """Burst -> time of its first event."""
    whole = EventPacket.concatenate(list(packets))
    return {int(x): int(whole.t[whole.x == x][0]) for x in np.unique(whole.x)}


def test_two_cameras_are_recorded_on_their_clocks_and_read_on_one(
    tmp_path: Path, out: socket.socket
) -> None:
    sources = two_cameras()
    prepare_folder(tmp_path / "day", overwrite=False)
    sender = threading.Thread(target=send_both, args=(out, sources))

    def begun(_: object) -> None:
        """Send once both cameras are read: what waited for its reader would arrive late."""
        if not sender.ident:
            sender.start()

    told = record(sources, tmp_path / "day", seconds=2.0, show=begun)
    sender.join()
    assert told["events"] == told["second"]["events"] == 200 * BURSTS
    assert told["time_base"]["learned_from"] == "host"
    recording = Recording.open(tmp_path / "day")
    assert recording.manifest["sensors"] == 2
    one, other = (burst_times(list(recording.events(sensor))) for sensor in (0, 1))
    assert one.keys() == other.keys()
    apart_us = [abs(one[number] - other[number]) for number in one]
    assert np.median(apart_us) < 10_000  # arrivals decide: this machine may be busy
    raw = burst_times(list(open_events(tmp_path / "day" / "events_1.raw")))
    assert abs(raw[0] - LATER_US - 1_000) < 10
    assert "clock" in " ".join(recording.events(1).notes)


def test_a_silent_camera_does_not_hold_the_other_one_back(out: socket.socket) -> None:
    sources = two_cameras()
    pair = live_pair(sources, ReadOptions())

    def go_on() -> None:
        for number in itertools.count():
            if ended.wait(PERIOD_S):
                return
            send(out, number, speaking)

    speaking, ended = [(sources[1], LATER_US)], threading.Event()
    sender = threading.Thread(target=go_on)
    sender.start()
    try:
        first = next(packet for packet in pair[1] if len(packet))
        speaking.append((sources[0], 0))
        begun = next(packet for packet in pair[0] if len(packet))
    finally:
        ended.set()
        sender.join()
        for source in sources:
            source.release()
    assert abs(int(first.t[0]) - LATER_US) < 1_000_000  # its own clock
    assert 0 < int(begun.t[0]) - LATER_US < 60_000_000  # the other one's clock, later


@pytest.fixture(scope="module")
def day(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two sensors that see the same, and their calibrations."""
    made = tmp_path_factory.mktemp("day")
    for name in ("events.raw", "events_1.raw"):
        save_events(made / name, *CirclingDots(duration_us=500_000, noise_per_ms=2))
    for name in ("calibration.json", "calibration_1.json"):
        replace(open_circling().calibration, step_on=0.2, step_off=0.2).save(made / name)
    return made


def calibrations(day: Path) -> list[object]:
    return [
        "--calibration", day / "calibration.json",
        "--second-calibration", day / "calibration_1.json",
    ]  # fmt: skip


def test_track_and_touch_take_two(day: Path, tmp_path: Path, verbs: Verbs) -> None:
    given = [day, "--second", day, *calibrations(day), *FAST]
    found = verbs.told("track", *given, "-o", tmp_path / "t.npz")
    assert found["second"]["output"] == str(tmp_path / "t_1.npz")
    one, other = Tracks.load(tmp_path / "t.npz"), Tracks.load(tmp_path / "t_1.npz")
    np.testing.assert_array_equal(one.t_us, other.t_us)
    np.testing.assert_array_equal(one.detected_px, other.detected_px)
    touched = verbs.told("touch", *given, "-o", tmp_path / "touches.csv")
    assert touched["second"]["t_first_us"] == touched["t_first_us"]
    assert touched["second"]["touches"] == touched["touches"]
    assert touched["health"]["gaps"] == 0
    assert (tmp_path / "touches_1.csv").read_text() == (tmp_path / "touches.csv").read_text()


def test_two_fingers_that_do_not_go_together_are_refused(day: Path, verbs: Verbs) -> None:
    for arguments, words in (
        (["track", day, "--second", day, "--calibration", day / "calibration.json"], "each"),
        (["touch", day, "--second", "udp:7777", *calibrations(day)], "one is a camera"),
        (["track", day, day, "--second", day, *calibrations(day)], "single one"),
        (["align", day / "events.raw"], "nothing to align"),
        (["align", day, "--by", "host"], "know no host"),
        (["align", day / "events.raw", day / "events_1.raw", "-o", day], "holds a recording"),
    ):
        assert words in verbs.said(*arguments, code=2)
