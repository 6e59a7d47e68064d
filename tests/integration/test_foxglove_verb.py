"""A sensor reaches a client that speaks Foxglove's protocol, written here on a plain web socket.

Source of the protocol: https://github.com/foxglove/ws-protocol (ws-protocol.md), version 1.
"""

from __future__ import annotations

import json
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed")

from rosbags.typesys import Stores, get_typestore
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from spikingtac.cli.main import main
from spikingtac.ros2 import messages
from stand_ins.tracks import circling_tracks

PROTOCOLS = ["foxglove.sdk.v1", "foxglove.websocket.v1"]
MESSAGE_DATA = 1
FRAMES = 300
PATIENCE_S = 60.0
CLOSING_S = 0.2  # A client that never read waits for so long for the end of a server that is gone.
FIELD = np.dtype([(name, "<f4") for name in ("x", "y", "z", "u", "v", "du", "dv", "valid")])


class Client:
    """Speaks the protocol."""

    def __init__(self, port: int) -> None:
        self.channels: dict[str, dict[str, Any]] = {}
        self.told: list[dict[str, Any]] = []
        self._opened = ExitStack()
        self.socket = self._connected(port)

    def close(self) -> None:
        self._opened.close()

    def _connected(self, port: int) -> ClientConnection:
        deadline_s = time.monotonic() + PATIENCE_S
        while True:
            try:
                opening = connect(
                    f"ws://127.0.0.1:{port}",
                    subprotocols=PROTOCOLS,
                    proxy=None,
                    close_timeout=CLOSING_S,
                )
                return self._opened.enter_context(opening)
            except OSError:
                assert time.monotonic() < deadline_s, "no server"
                time.sleep(0.05)

    def send(self, **message: Any) -> None:
        self.socket.send(json.dumps(message))

    def until(self, op: str) -> dict[str, Any]:
        """Return the next message of a kind; channels are remembered on the way."""
        while True:
            data = self.socket.recv(timeout=PATIENCE_S)
            if isinstance(data, bytes):
                continue
            message = json.loads(data)
            self.told.append(message)
            if message["op"] == "advertise":
                self.channels |= {one["topic"]: one for one in message["channels"]}
            if message["op"] == op:
                return message

    def subscribe(self, *topics: str) -> dict[int, str]:
        """Subscribe; return the topic of each subscription."""
        wanted = dict(enumerate(topics, 1))
        self.send(
            op="subscribe",
            subscriptions=[
                {"id": number, "channelId": self.channels[topic]["id"]}
                for number, topic in wanted.items()
            ],
        )
        return wanted

    def messages(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield subscription, log time (ns) and bytes of messages until the server ends."""
        try:
            while True:
                data = self.socket.recv(timeout=PATIENCE_S)
                if isinstance(data, bytes) and data[0] == MESSAGE_DATA:
                    number, t_ns = struct.unpack_from("<IQ", data, 1)
                    yield number, t_ns, data[13:]
        except ConnectionClosed:
            return


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@pytest.fixture(scope="module")
def tracks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tracks") / "tracks.npz"
    circling_tracks(estimates=FRAMES, px_per_mm=8.0).save(path)
    return path


@pytest.fixture
def served(tracks: Path) -> Iterator[tuple[subprocess.Popen[str], int]]:
    port = free_port()
    given = ["foxglove", str(tracks), "--port", str(port), "--field-hz", "1000", "--json"]
    process = subprocess.Popen(
        [sys.executable, "-m", "spikingtac", *given, "--wait-s", "60"],
        stdout=subprocess.PIPE,
        text=True,
    )
    yield process, port
    process.kill()
    process.communicate()


def test_every_field_is_read_as_it_was_tracked(served: tuple[subprocess.Popen[str], int]) -> None:
    process, port = served
    with closing(Client(port)) as stalled, closing(Client(port)) as client:
        _check_fields(process, stalled, client)


def _check_fields(process: subprocess.Popen[str], stalled: Client, client: Client) -> None:
    assert client.socket.subprotocol in PROTOCOLS
    info = client.until("serverInfo")
    assert info["name"] == "spikingtac"
    assert info["capabilities"] == [], "clients read, they change nothing"
    topics = {"/tactile/field", "/tactile/arrows", "/tactile/contact", "/diagnostics"}
    while not topics <= client.channels.keys():  # told in one message or in several
        client.until("advertise")
    channel = client.channels["/tactile/field"]
    assert (channel["encoding"], channel["schemaName"]) == ("cdr", "sensor_msgs/msg/PointCloud2")
    assert channel["schemaEncoding"] == "ros2msg"
    assert channel["schema"].startswith("std_msgs/Header header")
    while "/tactile/field" not in stalled.channels:
        stalled.until("advertise")
    wanted = client.subscribe("/tactile/field", "/tactile/contact")
    stalled.subscribe("/tactile/field")  # and never reads again
    found = list(client.messages())
    said = json.loads(process.communicate(timeout=PATIENCE_S)[0])
    assert said["messages"]["field"] == FRAMES
    store, known = get_typestore(Stores.ROS2_JAZZY), circling_tracks(estimates=FRAMES)
    clouds = [
        store.deserialize_cdr(data, "sensor_msgs/msg/PointCloud2")
        for number, _, data in found
        if wanted[number] == "/tactile/field"
    ]
    points = np.array([cloud.data.tobytes() for cloud in clouds])
    cloud = np.array([np.frombuffer(row, FIELD) for row in points])
    np.testing.assert_array_equal(cloud["u"], known.position_px[..., 0])
    np.testing.assert_array_equal(cloud["dv"], known.displacement_px[..., 1])
    contacts = [data for number, _, data in found if wanted[number] == "/tactile/contact"]
    assert store.deserialize_cdr(contacts[0], "std_msgs/msg/Bool").data in (True, False)


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Origin": "http://evil.com"}, 403),
        ({"Origin": "null"}, 403),
        ({"Host": "evil.com"}, 403),
        ({"Origin": "https://app.foxglove.dev"}, 101),
    ],
)
def test_foreign_pages_and_rebound_names_are_refused(
    served: tuple[subprocess.Popen[str], int], headers: dict[str, str], status: int
) -> None:
    with closing(Client(served[1])):  # it is up
        pass
    assert handshake(served[1], headers) == status


def handshake(port: int, headers: dict[str, str]) -> int:
    """Return the status of a handshake with headers of its own."""
    given = {
        "Host": f"127.0.0.1:{port}",
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Protocol": PROTOCOLS[0],
    } | headers
    lines = "".join(f"{name}: {value}\r\n" for name, value in given.items())
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as one:
        one.sendall(f"GET / HTTP/1.1\r\n{lines}\r\n".encode())
        return int(one.recv(64).split()[1])


def test_nothing_that_a_client_sends_ends_the_server(
    served: tuple[subprocess.Popen[str], int],
) -> None:
    with closing(Client(served[1])) as rude:
        for text in ("no json", "[]", '{"op": "setParameters"}', '{"op": "subscribe"}'):
            rude.socket.send(text)
        rude.send(op="subscribe", subscriptions=[{"id": "x"}])
        rude.until("advertise")
    with closing(Client(served[1])) as client:
        assert client.until("serverInfo")["name"] == "spikingtac"


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--port", "70000"], "0 to 65535"),
        (["--host", "everybody"], "no address"),
        (["--field-hz", "0"], "1 to 10000"),
    ],
)
def test_mistakes_are_told(
    tracks: Path, options: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["foxglove", str(tracks), *options]) == 2
    assert told in capsys.readouterr().err


def test_a_port_that_is_taken_is_told(tracks: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(["foxglove", str(tracks), "--port", str(port)]) == 3
    assert "another --port" in capsys.readouterr().err


def test_the_extra_is_named_where_it_is_missing(
    tracks: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    messages.type_store.cache_clear()
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    assert main(["foxglove", str(tracks)]) == 3
    assert "spikingtac[ros2]" in capsys.readouterr().err
