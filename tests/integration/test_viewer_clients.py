"""Pages that stall, crowd, send garbage or come from elsewhere; tracking goes on."""

from __future__ import annotations

import resource
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from spikingtac.stream.host import Factory
from spikingtac.viewer.process import SessionProcess
from spikingtac.viewer.server import UNACKNOWLEDGED
from stand_ins.serving import served
from stand_ins.viewer import open_circling, open_nothing
from stand_ins.wire import decode

pytestmark = pytest.mark.waits

# A loaded machine takes long for everything; a page that gets nothing takes for ever.
PATIENCE_S = 60.0
WATCHED_FRAMES = 200


def socket(port: int, **options: Any) -> ClientConnection:
    url = f"ws://127.0.0.1:{port}/socket"
    return connect(url, max_size=None, open_timeout=PATIENCE_S, **options)


def admitted(port: int) -> ClientConnection:
    """Connect as soon as there is room: the server may not yet have noticed that others left."""
    until_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return socket(port)
        except (InvalidStatus, ConnectionClosed):
            assert time.monotonic() < until_s, "nobody was let in"
            time.sleep(0.05)


def shown(client: ClientConnection) -> tuple[dict, dict]:
    """Return the next frame without acknowledging it."""
    while True:
        message = client.recv(PATIENCE_S)
        if isinstance(message, bytes):
            return decode(message)


def frame(client: ClientConnection) -> tuple[dict, dict]:
    got = shown(client)
    client.send('{"ack": 1}')
    return got


def ended(client: ClientConnection) -> bool:
    """Read what is on its way until the server closes the connection; times out otherwise."""
    with suppress(ConnectionClosed):
        while True:
            client.recv(PATIENCE_S)
    return True


def test_memory_does_not_grow_with_frames() -> None:
    session = SessionProcess(
        Factory(function=open_circling, arguments={"duration_us": 300_000}), repeat=True
    )
    try:
        sizes, number, until_s = [], 0, time.monotonic() + PATIENCE_S
        while len(sizes) < WATCHED_FRAMES and time.monotonic() < until_s:
            got = session.frame(number)
            if got is not None:
                number = got[0]
                sizes.append(resident_kb(session.pid))
            time.sleep(0.005)
        assert len(sizes) == WATCHED_FRAMES
        late = sizes[WATCHED_FRAMES // 2 :]
        assert np.median(late[-10:]) < np.median(late[:10]) + 8 * 1024
    finally:
        session.close()


def resident_kb(pid: int | None) -> int:
    try:
        text = Path(f"/proc/{pid}/statm").read_text()
    except OSError:
        pytest.skip("this system does not tell a process's memory")
    return int(text.split()[1]) * resource.getpagesize() // 1024


def test_a_session_that_cannot_open_says_why() -> None:
    session = SessionProcess(Factory(function=open_nothing))
    try:
        until_s = time.monotonic() + PATIENCE_S
        while session.alive and time.monotonic() < until_s:
            time.sleep(0.02)
        with pytest.raises(FileNotFoundError, match=r"nowhere\.raw"):
            session.require_alive()
    finally:
        session.close()


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    """A server for all tests from here on; those before have their own."""
    with served(open_circling) as number:
        yield number


def test_a_stalled_page_gets_no_more_than_it_may(port: int) -> None:
    with admitted(port) as stalled, admitted(port) as good:
        for _ in range(UNACKNOWLEDGED):
            last, _ = shown(stalled)
        for _ in range(10 * UNACKNOWLEDGED):
            latest, _ = frame(good)
        assert latest["stamp_ms"] > last["stamp_ms"]
        with pytest.raises(TimeoutError):
            stalled.recv(0)
        stalled.send('{"ack": 1}')
        late, _ = shown(stalled)
        assert late["stamp_ms"] >= latest["stamp_ms"]  # the latest, not a stored one


@pytest.mark.parametrize(
    "garbage", ["}{", '{"rm": 1}', b"\x00\xff" * 100, '{"seek_us": "x"}', "x" * 3000]
)
def test_garbage_ends_the_connection_and_nothing_else(port: int, garbage: str | bytes) -> None:
    with admitted(port) as good, admitted(port) as bad:
        frame(good)
        bad.send(garbage)
        assert ended(bad)
        frame(good)
