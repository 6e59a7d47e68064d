"""Two cameras in step: none waits long for one that is silent, and nothing else changes."""

import threading
from collections.abc import Iterator

import pytest

from spikingtac.contact.detector import DetectorSummary, Window, packets_of
from spikingtac.contact.recording import find_contacts, paired_windows
from spikingtac.events.source import PacketSource
from spikingtac.stream import pair
from spikingtac.stream.pair import live_windows
from spikingtac.types import Contact, EventPacket
from stand_ins.random_packets import packet_at

SIZE = (4, 4)
LONG_S = 20.0  # Nobody waits so long in a test that passes.


def packet(*t_us: int) -> EventPacket:
    return packet_at(t_us, (t_us[0], t_us[-1] + 1), SIZE)


class Camera(PacketSource):
    """Gives out packets; between two groups of them it is silent until the test goes on."""

    def __init__(self, *groups: list[EventPacket]) -> None:
        super().__init__([], SIZE)
        self._groups = groups
        self.speak = threading.Event()
        self.said = threading.Event()

    def __iter__(self) -> Iterator[EventPacket]:
        for number, group in enumerate(self._groups):
            if number:
                assert self.speak.wait(LONG_S), "the silent camera was waited for"
            yield from group
        self.said.set()


class OnFirst:
    """A detector of nothing but events of the first sensor."""

    in_contact = False

    def update(self, window: Window) -> Contact | None:
        begun, self.in_contact = not self.in_contact, len(packets_of(window)[0]) > 0
        return Contact(packets_of(window)[0].t_end_us, 1, 1) if begun and self.in_contact else None

    def reset(self) -> None: ...

    def summary(self) -> DetectorSummary:
        return DetectorSummary(rule="any event of the first sensor")


def stream(*t_us: int, cuts: tuple[int, ...] = ()) -> list[EventPacket]:
    """Return events in packets that follow each other, cut at some times."""
    parts = [packet(*t_us)]
    for cut_us in cuts:
        if t_us[0] < cut_us < t_us[-1]:
            parts += parts.pop().split(cut_us)
    return parts


def told(windows: Iterator[tuple[EventPacket, ...]] | Iterator[Window]) -> list[object]:
    return [
        [(one.t_start_us, one.t_end_us, one.t.tolist()) for one in packets_of(window)]
        for window in windows
    ]


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("SILENT_S", "STARTING_S"):
        monkeypatch.setattr(pair, name, LONG_S)


ONE, OTHER = (1_000, 1_400, 3_100, 7_999, 8_000, 11_400), (1_250, 2_250, 9_000, 9_001, 11_999)


@pytest.mark.parametrize("cuts", [(), (3_100,), (2_000, 8_000), (1_001, 5_000, 5_001, 9_999)])
def test_any_packets_of_two_cameras_give_the_windows_of_two_recordings(
    cuts: tuple[int, ...], patient: None
) -> None:
    recorded = told(paired_windows([PacketSource(stream(*t), SIZE) for t in (ONE, OTHER)]))
    cameras = [PacketSource(stream(*ONE, cuts=cuts), SIZE), PacketSource(stream(*OTHER), SIZE)]
    assert told(live_windows(cameras)) == recorded
    cameras = [PacketSource(stream(*ONE), SIZE), PacketSource(stream(*OTHER, cuts=cuts), SIZE)]
    assert told(live_windows(cameras)) == recorded
    assert len(recorded) == 10


def test_the_first_fingers_contact_is_told_while_the_second_one_is_silent() -> None:
    busy = Camera([packet(1_000), packet(1_500, 5_500)], [])
    silent = Camera([packet(1_000)], [])
    found = find_contacts([busy, silent], OnFirst(), live_windows([busy, silent]))
    assert next(found)[0].t_us == 2_000
    assert not silent.speak.is_set()
    for camera in (busy, silent):
        camera.speak.set()


def test_what_comes_after_its_time_was_told_is_counted_and_later_events_count() -> None:
    busy = Camera([packet(1_000, 4_500)], [packet(9_500)])
    silent = Camera([packet(1_000)], [packet(2_500, 3_500, 8_500, 9_600)])
    windows = live_windows([busy, silent])
    assert [next(windows)[0].t_start_us for _ in range(3)] == [1_000, 2_000, 3_000]
    silent.speak.set()
    assert silent.said.wait(LONG_S)
    busy.speak.set()
    rest = told(windows)
    assert silent.losses["late"] == 2
    assert rest[-1] == [(8_000, 9_000, []), (8_000, 9_000, [8_500])]


def test_a_camera_whose_time_leaps_does_not_silence_the_other_one(patient: None) -> None:
    """A wrong time of one sensor is no reason to go on without the other, which still delivers."""
    wrong = Camera([packet(1_000), packet(1_500, 7_200_000_000)], [])
    sound = Camera([packet(1_000 + 100 * n) for n in range(30)], [])
    windows = live_windows([wrong, sound])
    assert [len(next(windows)[1]) for _ in range(2)] == [10, 10]
    sound.speak.set()
    wrong.speak.set()
    assert list(windows) == []
