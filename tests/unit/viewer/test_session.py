"""A session under the commands of its pages, with every value of its frames known."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from spikingtac.errors import DeviceError
from spikingtac.types import EventPacket
from spikingtac.viewer import session as module
from spikingtac.viewer.server import CommandError, parse_command
from spikingtac.viewer.session import Session
from spikingtac.viewer.snapshot import MAGIC, PREFIX
from spikingtac.viewer.source import ViewSource
from stand_ins.viewer import SIZE, CirclingDots, open_circling, positions_px, reference_px


class Kept:
    """A publisher that keeps the last message."""

    def __init__(self) -> None:
        self.message = b""

    def publish(self, message: bytes) -> bool:
        self.message = message
        return True


Opened = tuple[Session, Kept, Kept]


@contextmanager
def session_of(view: ViewSource) -> Iterator[Opened]:
    frames, greetings = Kept(), Kept()
    session = Session(view, frames.publish, greetings.publish)
    yield session, frames, greetings
    session.close()


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> Iterator[Opened]:
    monkeypatch.setattr(module, "WORK_SHARE", 600.0)  # a step always reaches its aim
    with session_of(open_circling(duration_us=1_000_000)) as made:
        yield made


def unpack(packed: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return ``(height, width)`` codes of an image, of which two share a byte."""
    flat = np.stack([packed >> 4, packed & 15], axis=1).ravel()
    return flat[: size[0] * size[1]].reshape(size[1], size[0])


def decode(message: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return what ``encode`` was given, as a page reads it."""
    magic, length = PREFIX.unpack_from(message)
    assert magic == MAGIC
    body = PREFIX.size + length
    meta = json.loads(message[PREFIX.size : body])
    arrays = {
        name: np.frombuffer(message, f"<{kind}", int(np.prod(shape)), body + offset).reshape(shape)
        for name, kind, shape, offset in meta.pop("arrays")
    }
    return meta, arrays


def stepped(opened: Opened, steps: int = 1) -> tuple[dict, dict]:
    for _ in range(steps):
        opened[0].step()
    return decode(opened[1].message)


def test_frames_hold_what_was_tracked(opened: Opened) -> None:
    meta, arrays = stepped(opened, 20)
    expected = positions_px(meta["estimate_us"])
    np.testing.assert_allclose(arrays["position_px"], expected, atol=1e-4)
    np.testing.assert_allclose(arrays["truth_px"], expected, atol=0.01)
    assert arrays["held"].tolist() == [int(marker == 9) for marker in range(64)]
    assert meta["t_us"] == pytest.approx(20 / 60 * 1e6, abs=1000)
    store, last = opened[0].playback.store, meta["last_window"]
    assert arrays["counts"][-1] == len(store.between(last * 1000, (last + 1) * 1000))
    assert arrays["counts"].sum() == len(store.between(0, (last + 1) * 1000))
    exposed = store.between(meta["t_us"] - 30_000, meta["t_us"])
    shown = unpack(arrays["activity"], SIZE)
    np.testing.assert_array_equal(np.unique(np.nonzero(shown)[1]), np.unique(exposed.x))
    assert meta["losses"] == {"time_gap": 2}
    assert "map" not in arrays


def test_pause_holds_the_time_and_seeking_moves_it(opened: Opened) -> None:
    stepped(opened, 5)
    opened[0].command("play", False)
    before = stepped(opened)[0]["t_us"]
    assert stepped(opened, 3)[0]["t_us"] == before
    opened[0].command("seek_us", 750_000)
    meta, arrays = stepped(opened)
    assert meta["t_us"] == 750_000
    assert 0 <= meta["t_us"] - meta["estimate_us"] < 1e6 / open_circling().rate_hz
    np.testing.assert_allclose(arrays["position_px"], positions_px(meta["estimate_us"]), atol=1e-4)
    opened[0].command("seek_us", 10**15)
    assert stepped(opened)[0]["t_us"] == 1_000_000


def test_a_control_acts_on_what_is_shown(opened: Opened) -> None:
    stepped(opened, 10)
    opened[0].command("play", False)
    opened[0].command("set", ["gain", 2.0])
    meta, arrays = stepped(opened)
    moved = positions_px(meta["estimate_us"]) - reference_px()
    np.testing.assert_allclose(arrays["position_px"] - reference_px(), 2 * moved, atol=1e-3)
    assert json.loads(opened[2].message)["controls"][0]["value"] == 2.0
    opened[0].command("defaults", True)
    _, arrays = stepped(opened)
    np.testing.assert_allclose(arrays["position_px"] - reference_px(), moved, atol=1e-3)


class Cut(CirclingDots):
    """A live sensor whose cable is pulled after 0.2 s."""

    def __iter__(self) -> Iterator[EventPacket]:
        for packet in super().__iter__():
            if packet.t_start_us == 200_000:
                raise DeviceError("the sensor was unplugged")
            yield packet


@pytest.fixture
def live(monkeypatch: pytest.MonkeyPatch) -> Iterator[Opened]:
    monkeypatch.setattr(module, "WORK_SHARE", 600.0)
    with session_of(replace(open_circling(), source=Cut(10**6), ends=False)) as made:
        yield made


def test_what_came_before_a_source_was_lost_can_be_looked_at(live: Opened) -> None:
    assert stepped(live, 3)[0]["failure"] is None
    meta, _ = stepped(live, 17)
    assert (meta["state"], meta["failure"]) == ("DISCONNECTED", "the sensor was unplugged")
    assert isinstance(live[0].failure, DeviceError)
    live[0].command("seek_us", 50_000)
    live[0].command("play", False)
    meta, arrays = stepped(live)
    assert meta["failure"] == "the sensor was unplugged"
    assert meta["t_us"] == 50_000
    np.testing.assert_allclose(arrays["position_px"], positions_px(meta["estimate_us"]), atol=1e-4)


def test_commands_are_understood() -> None:
    for command in (
        {"ack": 7}, {"play": True}, {"speed": 0.25}, {"speed": 2}, {"seek_us": -5}, {"map": False},
        {"exposure_us": 30000}, {"set": ["gain", 1.5]}, {"set": ["law", "paper"]},
        {"defaults": True}, {"calibrate": True},
    ):  # fmt: skip
        assert [parse_command(json.dumps(command))] == list(command.items())


@pytest.mark.parametrize(
    "text",
    [
        "", "null", "[]", "{}", '{"play": 1}', '{"play": true, "ack": 1}', '{"speed": 0}',
        '{"speed": 1e9}', '{"speed": NaN}', '{"speed": true}', '{"seek_us": 1.5}',
        '{"seek_us": 1e300}', '{"exposure_us": 1}', '{"set": ["gain"]}', '{"set": ["gain", [1]]}',
        '{"set": {"gain": 1, "b": 2}}', '{"set": "ab"}', '{"exec": "x"}', "[" * 900,
        '{"set": [[], 1]}', '{"set": ["' + "x" * 2000 + '", 1]}',
    ],
)  # fmt: skip
def test_everything_else_is_refused(text: str) -> None:
    with pytest.raises(CommandError):
        parse_command(text)
