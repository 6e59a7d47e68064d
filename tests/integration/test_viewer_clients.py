"""Pages that stall, crowd, send garbage or come from elsewhere; tracking goes on."""

from __future__ import annotations

import json
import resource
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import httpx
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from spikingtac.errors import SpikingTacError
from spikingtac.viewer.hub import MOST_PAGES, UNACKNOWLEDGED
from spikingtac.viewer.process import SessionProcess
from spikingtac.viewer.wire import decode
from stand_ins.serving import served
from stand_ins.viewer import open_circling, open_nothing

WATCHED_S = 1.5


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with served(open_circling) as number:
        yield number


def socket(port: int, **options: object) -> ClientConnection:
    return connect(f"ws://127.0.0.1:{port}/socket", max_size=None, **options)  # type: ignore[arg-type]


def frame(client: ClientConnection, timeout: float = 5.0) -> tuple[dict, dict]:
    while True:
        message = client.recv(timeout)
        if isinstance(message, bytes):
            client.send('{"ack": 1}')
            return decode(message)


def ended(client: ClientConnection) -> bool:
    """Read what is on its way; True once the server has closed the connection."""
    try:
        for _ in range(2 + UNACKNOWLEDGED):
            client.recv(5)
    except ConnectionClosed:
        return True
    return False


def pace(client: ClientConnection) -> float:
    """Return estimates per second of the wall clock, as the session counts them."""
    first, _ = frame(client)
    last = first
    while last["stamp_ms"] - first["stamp_ms"] < 1000 * WATCHED_S:
        last, _ = frame(client)
    return (last["steps"] - first["steps"]) / (last["stamp_ms"] - first["stamp_ms"]) * 1000


def test_a_page_gets_a_greeting_and_then_frames(port: int) -> None:
    with socket(port) as client:
        greeting = client.recv(5)
        assert isinstance(greeting, str)
        assert json.loads(greeting)["label"] == "circling dots"
        first, _ = frame(client)
        second, _ = frame(client)
        assert second["stamp_ms"] > first["stamp_ms"]


def test_a_stalled_page_gets_no_more_than_it_may(port: int) -> None:
    with socket(port) as client:
        received = 0
        with suppress(TimeoutError):
            while received <= UNACKNOWLEDGED:
                received += isinstance(client.recv(1.0), bytes)
        assert received == UNACKNOWLEDGED
        client.send('{"ack": 1}')
        late, _ = decode(client.recv(2.0))  # type: ignore[arg-type]
        assert time.time() * 1000 - late["stamp_ms"] < 500  # the latest, not a stored one


def test_twenty_stalled_pages_do_not_slow_tracking(port: int) -> None:
    with ExitStack() as stack, socket(port) as watcher:
        alone = pace(watcher)
        for _ in range(20):
            stack.enter_context(socket(port))
        crowded = pace(watcher)
    print(f"{alone:.0f} estimates/s alone, {crowded:.0f} beside twenty stalled pages")
    # The loop is paced: on an idle machine both are 1,000 per second. A loaded machine moves both.
    assert crowded > 0.7 * alone


def test_too_many_pages_are_turned_away(port: int) -> None:
    with ExitStack() as stack:
        for _ in range(MOST_PAGES):
            stack.enter_context(socket(port)).recv(5)
        with pytest.raises((InvalidStatus, ConnectionClosed)), socket(port) as late:
            late.recv(5)
    time.sleep(0.3)
    with socket(port) as client:
        assert frame(client)[0]["steps"] > 0


@pytest.mark.parametrize(
    "garbage", ["}{", '{"rm": 1}', b"\x00\xff" * 100, '{"seek_us": "x"}', "x" * 3000]
)
def test_garbage_ends_the_connection_and_nothing_else(port: int, garbage: str | bytes) -> None:
    with socket(port) as good, socket(port) as bad:
        frame(good)
        bad.send(garbage)
        assert ended(bad)
        frame(good)


def test_oversized_messages_are_refused(port: int) -> None:
    with socket(port) as bad:
        bad.send("x" * 1_000_000)
        assert ended(bad)


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://localhost:1"])
def test_a_foreign_origin_is_refused(port: int, origin: str) -> None:
    with pytest.raises(InvalidStatus) as refused, socket(port, origin=origin):
        pass
    assert refused.value.response.status_code == 403


def test_a_rebound_name_is_refused(port: int) -> None:
    for path in ("/", "/viewer.js", "/socket"):
        answer = httpx.get(f"http://127.0.0.1:{port}{path}", headers={"host": f"evil.test:{port}"})
        assert answer.status_code in (403, 404)
        assert "<html" not in answer.text


def test_the_page_comes_with_its_policy(port: int) -> None:
    answer = httpx.get(f"http://127.0.0.1:{port}/")
    assert answer.status_code == 200
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert "http://" not in answer.text
    assert "https://" not in answer.text


@pytest.mark.parametrize(
    "path", ["/../server.py", "/%2e%2e/server.py", "/..%2fserver.py", "/server.py", "/x.js"]
)
def test_only_the_page_is_served(port: int, path: str) -> None:
    assert httpx.get(f"http://127.0.0.1:{port}{path}").status_code in (400, 403, 404)


def test_a_token_guards_a_server_that_others_can_reach() -> None:
    with served(open_circling, token="s3cret") as number:
        url = f"http://127.0.0.1:{number}/"
        assert httpx.get(url).status_code == 403
        assert httpx.get(url, params={"token": "wrong"}).status_code == 403
        assert httpx.get(url, params={"token": "s3cret"}).status_code == 200
        with pytest.raises(InvalidStatus), socket(number):
            pass
        with connect(f"ws://127.0.0.1:{number}/socket?token=s3cret", max_size=None) as client:
            assert frame(client)[1]["position_px"].shape == (64, 2)


def test_memory_does_not_grow_with_frames() -> None:
    session = SessionProcess(open_circling, {"duration_us": 300_000}, repeat=True)
    try:
        sizes, number, until_s = [], 0, time.monotonic() + 4
        while time.monotonic() < until_s:
            got = session.frame(number)
            number = got[0] if got else number
            sizes.append(resident_kb(session.pid))
            time.sleep(0.05)
        assert number > 50
        assert np.median(sizes[-10:]) < np.median(sizes[len(sizes) // 2 :][:10]) + 8 * 1024
    finally:
        session.close()


def resident_kb(pid: int | None) -> int:
    try:
        text = Path(f"/proc/{pid}/statm").read_text()
    except OSError:
        pytest.skip("this system does not tell a process's memory")
    return int(text.split()[1]) * resource.getpagesize() // 1024


def test_a_session_that_cannot_open_says_why() -> None:
    session = SessionProcess(open_nothing, {})
    try:
        until_s, error = time.monotonic() + 30, None
        while error is None and time.monotonic() < until_s:
            error = session.failure()
            time.sleep(0.02)
        assert isinstance(error, FileNotFoundError)
        assert not isinstance(error, SpikingTacError)
        assert error.filename == "nowhere.raw"
    finally:
        session.close()
