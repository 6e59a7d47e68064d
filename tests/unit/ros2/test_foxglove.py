"""A sensor reaches clients that speak Foxglove's protocol, written here on a plain web socket.

Source of the protocol: https://github.com/foxglove/ws-protocol (ws-protocol.md), version 1.
"""

from __future__ import annotations

import json
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed")

from rosbags.typesys import Stores, get_typestore
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from spikingtac.cli.main import main
from spikingtac.cli.verbs.ros2 import FOXGLOVE_ORIGINS
from spikingtac.ros2 import messages
from spikingtac.ros2.foxglove import BACKLOG_BYTES, FoxglovePublisher
from spikingtac.ros2.stream import FIELD, SensorInfo, SensorStream
from spikingtac.viewer.access import Gate, listen
from stand_ins.tracks import circling_tracks

PROTOCOLS = ["foxglove.sdk.v1", "foxglove.websocket.v1"]
FRAMES, PATIENCE_S = 100, 60.0


@pytest.fixture
def publisher() -> Iterator[FoxglovePublisher]:
    given = listen("127.0.0.1", 0), Gate().refusal, FOXGLOVE_ORIGINS
    with closing(FoxglovePublisher(*given)) as served:
        yield served


@pytest.fixture
def connected(publisher: FoxglovePublisher) -> Iterator[Callable[..., Client]]:
    """Make clients that end with the test."""
    with ExitStack() as opened:
        yield partial(Client, opened, publisher)


class Client:
    """Speaks the protocol; it has subscribed to some topics once it is made."""

    def __init__(self, opened: ExitStack, publisher: FoxglovePublisher, *topics: str) -> None:
        address = f"ws://127.0.0.1:{publisher.port}"
        opening = connect(address, subprotocols=PROTOCOLS, proxy=None, close_timeout=0.2)
        self.socket = opened.enter_context(opening)
        self.told = [json.loads(self.socket.recv(PATIENCE_S)) for _ in range(2)]
        self.channels = {one["topic"]: one for one in self.told[1]["channels"]}
        wanted = [
            {"id": n, "channelId": self.channels[name]["id"]} for n, name in enumerate(topics)
        ]
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        while topics and not publisher.readers(topics[-1]):
            pass

    def messages(self, number: int) -> list[bytes]:
        """Return what came of a subscription until the server ended."""
        came: list[Any] = []
        with suppress(ConnectionClosed):
            came.extend(self.socket)
        return [data[13:] for data in came if struct.unpack_from("<BI", data) == (1, number)]


def test_every_field_is_read_as_it_was_tracked_and_a_client_that_stalls_does_no_harm(
    publisher: FoxglovePublisher, connected: Callable[..., Client]
) -> None:
    known = circling_tracks(estimates=FRAMES, px_per_mm=8.0)
    stream = SensorStream(publisher, SensorInfo(known.reference_px, (8, 8), 8.0))
    frames = list(known.frames())
    stream.frame(frames[0])
    client = connected("/tactile/contact", "/tactile/field")
    connected("/tactile/field")  # never reads
    assert client.socket.subprotocol in PROTOCOLS
    info, channel = client.told[0], client.channels["/tactile/field"]
    assert (info["op"], info["capabilities"]) == ("serverInfo", []), "clients change nothing"
    assert (channel["encoding"], channel["schemaName"]) == ("cdr", "sensor_msgs/msg/PointCloud2")
    assert channel["schema"].startswith("std_msgs/Header header")
    for frame in frames[1:]:
        stream.frame(frame)
    for _ in range(4 * BACKLOG_BYTES // (64 * FIELD.itemsize)):
        publisher.publish("/tactile/field", {"data": bytes(64 * FIELD.itemsize)}, 0)
    publisher.close()
    store = get_typestore(Stores.ROS2_JAZZY)
    clouds = [store.deserialize_cdr(d, "sensor_msgs/msg/PointCloud2") for d in client.messages(1)]
    cloud = np.array([np.frombuffer(cloud.data.tobytes(), FIELD) for cloud in clouds])
    np.testing.assert_array_equal(cloud["u"][: FRAMES - 1], known.position_px[1:, :, 0])
    np.testing.assert_array_equal(cloud["dv"][: FRAMES - 1], known.displacement_px[1:, :, 1])


def test_who_comes_late_gets_the_last_state(
    publisher: FoxglovePublisher, connected: Callable[..., Client]
) -> None:
    publisher.advertise("/tactile/contact", "std_msgs/Bool", state=True)
    for touching in (False, True):
        publisher.publish("/tactile/contact", {"data": touching}, 0)
    client = connected("/tactile/contact")
    publisher.close()
    assert client.messages(0) == [messages.encode("std_msgs/Bool", {"data": True})]


def test_foreign_pages_and_rebound_names_are_refused(publisher: FoxglovePublisher) -> None:
    for origin, host, status in (
        ("http://evil.com", "127.0.0.1", 403),
        ("null", "127.0.0.1", 403),
        ("https://app.foxglove.dev", "evil.com", 403),
        ("https://app.foxglove.dev", "127.0.0.1", 101),
    ):
        asked = (
            f"GET / HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\nConnection: Upgrade\r\n"
            "Upgrade: websocket\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
            f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: {PROTOCOLS[0]}\r\n\r\n"
        )
        with socket.create_connection(("127.0.0.1", publisher.port), timeout=PATIENCE_S) as one:
            one.sendall(asked.encode())
            assert int(one.recv(64).split()[1]) == status, (origin, host)


def test_nothing_that_a_client_does_ends_the_server(
    publisher: FoxglovePublisher, connected: Callable[..., Client], caplog: pytest.LogCaptureFixture
) -> None:
    publisher.advertise("/tactile/arrows", "std_msgs/Bool")
    rude = connected()
    asked: list[Any] = [
        [], {"op": "setParameters"}, {"op": "subscribe"},
        {"op": "subscribe", "subscriptions": [{"id": "x"}]},
        *({"op": "subscribe", "subscriptions": [{"id": n, "channelId": 1}]} for n in (1 << 32, 7)),
    ]  # fmt: skip
    for text in ("no json", *map(json.dumps, asked)):
        rude.socket.send(text)
    while not publisher.readers("/tactile/arrows"):
        pass
    publisher.publish("/tactile/arrows", {"data": True}, 0)
    rude.socket.socket.shutdown(socket.SHUT_RDWR)  # it vanishes without a word
    assert connected().told[0]["name"] == "spikingtac"
    assert caplog.text == ""


def test_mistakes_are_told(
    publisher: FoxglovePublisher, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    circling_tracks(estimates=10).save(tmp_path / "tracks.npz")
    for options, code, told in (
        (["--field-hz", "0"], 2, "1 to 10000"),
        (["--port", str(publisher.port)], 3, "another one: --port"),
    ):
        assert main(["foxglove", str(tmp_path / "tracks.npz"), *options]) == code
        assert told in capsys.readouterr().err
