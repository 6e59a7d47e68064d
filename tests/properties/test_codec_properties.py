"""Codecs on generated input: round trips, and survival of anything that a disk can hold.

SPIKINGTAC_EXAMPLES=10000 sets the number of examples of each property (100 unless given). The
attack on every reader is short here; ``benchmarks/attack.py`` is the long one.
"""

import os
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from spikingtac.errors import RecordingError
from spikingtac.events import open_events
from spikingtac.types import EventPacket
from stand_ins.hostile_files import FILE_NAMES, KINDS, mutated, outcome, seed_file
from stand_ins.random_packets import assert_equal, packet_of, save_events, whole

EXAMPLES = int(os.environ.get("SPIKINGTAC_EXAMPLES", "100"))
SIZE = (320, 240)
ENCODINGS = ("evt2", "evt21", "evt3")
many = settings(
    max_examples=EXAMPLES,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@st.composite
def packets(draw: st.DrawFn) -> EventPacket:
    n = draw(st.integers(0, 200))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    steps = rng.integers(0, draw(st.sampled_from([1, 2, 100, 10_000, 9_000_000])), n)
    t = np.cumsum(steps) + draw(st.sampled_from([0, 5, (1 << 24) - 3, (1 << 34) + 7]))
    y = rng.integers(0, draw(st.sampled_from([1, 3, 240])), n)
    x = np.sort(rng.integers(0, 320, n)) if draw(st.booleans()) else rng.integers(0, 320, n)
    return packet_of(t, x, y, rng.random(n) < 0.5, SIZE)


def assert_sound(events: EventPacket) -> None:
    assert (np.diff(events.t) >= 0).all()
    assert (events.x < events.size[0]).all()
    assert (events.y < events.size[1]).all()


@pytest.mark.parametrize("encoding", ENCODINGS)
@many
@given(packet=packets(), cut=st.integers(0, 200), chunk=st.integers(1, 300))
def test_raw_round_trip(tmp_path: Path, encoding: str, packet, cut: int, chunk: int) -> None:
    parts = packet.sound().part(0, cut, 0, 0), packet.part(cut, len(packet), 0, 0)
    path = save_events(tmp_path / "a.raw", *parts, encoding=encoding)
    source = open_events(path, strict=True, chunk_events=chunk)
    assert_equal(whole(source), packet)
    assert not source.losses or set(source.losses) == {"time_jump"}


def damaged(data: bytes, kind: str, share: float, amount: int) -> bytes:
    out, at = bytearray(data), int(share * len(data))
    random = np.random.default_rng(amount)
    if kind == "flip":
        out[at] ^= 1 << amount % 8
    elif kind == "lose":
        del out[at : at + amount % 9]
    elif kind == "insert":
        out[at:at] = random.bytes(amount % 9)
    else:
        out[at : at + amount] = random.bytes(amount) if kind == "noise" else bytes(amount)
    return bytes(out)


def survive(path: Path) -> None:
    with suppress(RecordingError):  # anything else, and anything unsound, fails the test
        assert_sound(whole(open_events(path)))


@many
@example(data=b"\r\x00")
@given(data=st.binary(max_size=2_000))
def test_random_files_survive(tmp_path: Path, data: bytes) -> None:
    for ending in ("raw", "csv", "dat", "es", "npz"):
        path = tmp_path / f"a.{ending}"
        path.write_bytes(data)
        survive(path)


def share_recovered(truth: EventPacket, found: EventPacket) -> float:
    def keys(events: EventPacket) -> np.ndarray:
        return ((events.t << 10 | events.x) << 10 | events.y) << 1 | events.p

    return float(np.isin(keys(truth), keys(found)).mean())


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("kind", ["flip", "lose", "insert", "noise", "zero"])
@pytest.mark.parametrize("seed", range(6))
def test_local_damage_costs_little(tmp_path: Path, encoding: str, kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 30_000
    t = np.cumsum(rng.integers(0, 3, n))
    rows = np.sort(rng.integers(0, 240, n).reshape(-1, 20), axis=1).ravel()
    truth = packet_of(t, rng.integers(0, 320, n), rows, rng.random(n) < 0.5, SIZE)
    path = save_events(tmp_path / "a.raw", truth, encoding=encoding)
    head, end, data = path.read_bytes().partition(b"% end\n")
    for share in rng.random(4):
        data = damaged(data, kind, share, int(rng.integers(1, 400)))
    path.write_bytes(head + end + data)
    found = whole(open_events(path))
    assert_sound(found)
    assert share_recovered(truth, found) > 0.9


MUTANTS = 25


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_read_or_refused(tmp_path: Path, kind: str) -> None:
    sound = seed_file(kind, tmp_path)
    assert outcome(sound) == "read"
    data = sound.read_bytes()
    path = tmp_path / "m" / FILE_NAMES[kind]
    path.parent.mkdir()
    outcomes = set()
    for seed in range(MUTANTS):
        path.write_bytes(mutated(data, np.random.default_rng(seed)))
        outcomes.add(outcome(path))
    assert outcomes <= {"read", "refused"}
    assert "read" in outcomes or kind in ("h5", "npz", "npy")
