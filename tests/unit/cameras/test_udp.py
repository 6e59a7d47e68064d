"""Datagrams that are lost, come late, twice, cut or from strangers: kept, mended or counted."""

import socket
from collections.abc import Iterable, Iterator

import numpy as np
import pytest

from spikingtac.cameras import udp
from spikingtac.cameras.udp import UdpCamera
from spikingtac.errors import DeviceError, FormatError
from spikingtac.events.camera import Address
from spikingtac.types import EventPacket
from stand_ins.camera_counterparts import datagrams, events

pytestmark = pytest.mark.waits

SENT = events(20_000)


@pytest.fixture
def camera() -> Iterator[UdpCamera]:
    camera = UdpCamera.open(Address.parse("udp:127.0.0.1:0?encoding=evt2"))
    yield camera
    camera.close()


def sent(out: socket.socket, camera: UdpCamera, pieces: Iterable[bytes]) -> None:
    for piece in pieces:
        out.sendto(piece, ("127.0.0.1", camera.port))


def events_in(pieces: Iterable[bytes]) -> int:
    return sum(int(np.count_nonzero(np.frombuffer(piece, "<u4") >> 28 < 2)) for piece in pieces)


def received(camera: UdpCamera) -> EventPacket:
    parts = []
    while len((rows := camera.read(0.2) or camera.nothing())[3]):
        x, y, p, t = (column.copy() for column in rows)
        parts.append(EventPacket(x, y, p, t, int(t[0]), int(t[-1]) + 1, (320, 320)))
    return EventPacket.concatenate(parts)


def test_loss_costs_its_own_events_and_no_other(camera: UdpCamera, out: socket.socket) -> None:
    pieces = datagrams(SENT)
    sent(out, camera, [piece for number, piece in enumerate(pieces) if number % 10 != 5])
    found = received(camera)
    assert len(found) == pytest.approx(0.9 * len(SENT), rel=0.02)
    # Each event that arrived is one that was sent, at its time or within the stretch that was lost.
    lost_us = 1.5 * (SENT.t[-1] - SENT.t[0]) / len(pieces)
    sent_us, found_us = SENT.t - SENT.t[0], found.t - found.t[0]
    at = np.searchsorted(sent_us, found_us)
    assert np.abs(sent_us[np.minimum(at, len(SENT) - 1)] - found_us).max() <= lost_us
    assert (np.diff(found.t) >= 0).all()


def test_what_comes_late_together_is_put_in_order(camera: UdpCamera, out: socket.socket) -> None:
    pieces = datagrams(SENT)[:40]
    sent(out, camera, [pieces[number ^ 1] for number in range(40)])
    found = received(camera)
    count = len(found)
    np.testing.assert_array_equal(found.x, SENT.x[:count])
    np.testing.assert_array_equal(found.t - found.t[0], (SENT.t - SENT.t[0])[:count])
    assert camera.losses["reordered"] == 20


def test_what_comes_too_late_keeps_its_events(camera: UdpCamera, out: socket.socket) -> None:
    pieces = datagrams(SENT)[:10]
    late = pieces.pop(3)
    sent(out, camera, pieces)
    before = received(camera)
    sent(out, camera, [late])
    after = received(camera)
    assert camera.losses["reordered"] == 1
    assert after.t[0] >= before.t[-1]
    assert len(before) + len(after) == events_in([*pieces, late])


def test_what_comes_twice_counts_once(camera: UdpCamera, out: socket.socket) -> None:
    sent(out, camera, (piece for piece in datagrams(SENT)[:30] for _ in range(2)))
    found = received(camera)
    np.testing.assert_array_equal(found.x, SENT.x[: len(found)])
    assert camera.losses["duplicate"] == 30


def test_a_cut_datagram_ends_with_its_last_word(camera: UdpCamera, out: socket.socket) -> None:
    pieces = datagrams(SENT)[:4]
    sent(out, camera, (pieces[0][:-3], *pieces[1:]))
    found = received(camera)
    assert camera.losses["truncated"] == 1
    assert set(found.x.tolist()) <= set(range(320))


def test_nobody_but_a_camera_locks_the_socket(camera: UdpCamera, out: socket.socket) -> None:
    here = "127.0.0.1", camera.port
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for noise in (b"", b"hello", bytes(range(256)) * 4):
            stranger.sendto(noise, here)
        assert len((camera.read(0.2) or camera.nothing())[3]) == 0
        for piece in datagrams(SENT)[:3]:
            out.sendto(piece, here)
            stranger.sendto(piece, here)  # another port of the same host
        found = received(camera)
    np.testing.assert_array_equal(found.x, SENT.x[: len(found)])
    assert camera.losses["foreign"] == 3 + 3
    assert camera._socket.getsockname()[0] == "127.0.0.1"


def test_a_sender_that_falls_silent_may_be_followed(
    camera: UdpCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(udp, "SILENT_S", 0.0)
    for piece in datagrams(SENT)[:2]:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(piece, ("127.0.0.1", camera.port))
            assert len((camera.read(0.5) or camera.nothing())[3]) > 0


def test_a_stranger_ends_no_camera_that_was_heard(
    camera: UdpCamera, out: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(udp, "SILENT_S", 0.0)
    sent(out, camera, datagrams(SENT)[:1])
    assert len(received(camera)) > 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        sent(stranger, camera, datagrams(SENT, "evt3")[:40])
    assert len((camera.read(0.2) or camera.nothing())[3]) == 0
    assert camera.losses["foreign"] == 40


@pytest.mark.parametrize("other", ["evt3", "evt21"])
def test_another_encoding_is_named(camera: UdpCamera, out: socket.socket, other: str) -> None:
    sent(out, camera, datagrams(SENT, other)[:40])
    with pytest.raises(FormatError, match=f"encoding={other}"):
        received(camera)


def test_what_the_kernel_drops_is_counted(camera: UdpCamera, out: socket.socket) -> None:
    camera._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 14)
    pieces = datagrams(SENT)[:80]
    sent(out, camera, pieces)
    found = received(camera)
    lost = camera.losses["overflow"]
    assert 0 < lost < len(pieces)
    assert len(found) == pytest.approx(events_in(pieces) * (1.0 - lost / len(pieces)), rel=0.05)


def test_a_port_that_is_taken_says_so(camera: UdpCamera) -> None:
    with pytest.raises(DeviceError, match="another program"):
        UdpCamera.open(Address.parse(f"udp:127.0.0.1:{camera.port}"))
