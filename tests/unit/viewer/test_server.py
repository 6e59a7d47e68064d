"""Who may see the page, what every answer carries, and that nothing silent is waited for."""

import asyncio
import os
import signal
import time
from collections.abc import Awaitable, Callable
from contextlib import closing
from functools import partial
from typing import Any, cast

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from spikingtac.errors import ConfigError, DeviceError
from spikingtac.stream.ring import SharedRing
from spikingtac.viewer import process as process_module
from spikingtac.viewer import server
from spikingtac.viewer import show as show_module
from spikingtac.viewer.access import Gate, PageOptions, listen
from spikingtac.viewer.process import SessionProcess
from spikingtac.viewer.server import UNACKNOWLEDGED, PageServer, serve
from spikingtac.viewer.show import show
from stand_ins.viewer import open_circling, open_nothing
from stand_ins.waiting import wait_until

pytestmark = pytest.mark.waits

PATIENCE_S = 60.0
BRIEF_S = 0.05


class Feed:
    """A session that greets at once; its first frame may come late."""

    def __init__(self) -> None:
        self.frames, self.greetings = SharedRing.create(1_000), SharedRing.create(1_000)
        self.greetings.publish(b"{}")
        self.commands: list[tuple[str, Any]] = []

    def tell(self, command: tuple[str, Any]) -> None:
        self.commands.append(command)


def ask(request: bytes, token: str = "") -> bytes:
    """Send bytes to a server; return what came until it hung up."""

    async def run() -> bytes:
        feed: Any = Feed()
        with listen("127.0.0.1", 0) as listening:
            async with PageServer(feed, Gate(token=token)).serving(listening):
                reader, writer = await asyncio.open_connection(*listening.getsockname())
                writer.write(request)
                answer = await asyncio.wait_for(reader.read(), PATIENCE_S)
                writer.close()
                return answer

    return asyncio.run(run())


def get(path: str, headers: dict[str, str]) -> tuple[int, str]:
    """Return status and text of an answer, headers and all."""
    given = {"Host": "127.0.0.1"} | headers
    lines = "".join(f"{name}: {value}\r\n" for name, value in given.items())
    answer = ask(f"GET {path} HTTP/1.1\r\n{lines}\r\n".encode()).decode()
    return int(answer.split()[1]), answer


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        ("/", {}, 200), ("/missing.js", {}, 404), ("/../wire.py", {}, 404), ("/socket", {}, 426),
        ("/socket", {"Origin": "http://evil.example"}, 403),
        ("/", {"Origin": "http://evil.example"}, 403), ("/", {"Host": "evil.example"}, 403),
        ("/viewer.js", {"Host": "evil.example; script-src *"}, 403),
    ],
)  # fmt: skip
def test_every_answer_carries_the_security_headers(
    path: str, headers: dict[str, str], status: int
) -> None:
    found, answer = get(path, headers)
    head = answer.partition("\r\n\r\n")[0].lower()
    assert found == status
    assert "evil" not in head
    for line in ("content-security-policy: default-src 'none'", "x-content-type-options: nosniff",
                 "cache-control: no-store"):  # fmt: skip
        assert line in head


@pytest.mark.parametrize("token", ["", "s3cret"])
@pytest.mark.parametrize("path", ["/", "/viewer.js", "/missing.js", "/socket"])
def test_a_request_without_host_is_refused_and_enters_no_policy(token: str, path: str) -> None:
    answer = ask(f"GET {path}?token=s3cret HTTP/1.1\r\n\r\n".encode(), token)
    assert answer.split()[1] == b"403"
    assert b"ws://" not in answer


@pytest.mark.parametrize("half", [b"", b"GET /viewer.js HT", b"GET / HTTP/1.1\r\nHost: 127.0.0.1"])
def test_a_half_sent_request_is_hung_up_on(half: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "REQUEST_S", 0.3)
    assert b"200 OK" not in ask(half)


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> Callable[..., SessionProcess]:
    """Show the circling discs and disturb the session's process once the page is served."""
    made: list[SessionProcess] = []

    def start(*arguments: Any, **options: Any) -> SessionProcess:
        made.append(SessionProcess(*arguments, **options))
        return made[-1]

    def run(disturb: Callable[[int], None], failure: str) -> SessionProcess:
        def ready(line: str) -> None:
            if line.startswith("open "):
                disturb(made[0].pid)

        monkeypatch.setattr(show_module, "SessionProcess", start)
        options = PageOptions(port=0, no_browser=True, seconds=PATIENCE_S)
        view = partial(open_circling, duration_us=300_000)
        with pytest.raises(DeviceError, match=failure):
            show(view, options, ready)
        return made[0]

    return run


def test_a_session_that_was_killed_is_a_failure(shown: Callable[..., SessionProcess]) -> None:
    shown(lambda pid: os.kill(pid, signal.SIGKILL), "was killed")


def test_ctrl_c_ends_a_session_that_hangs(
    shown: Callable[..., SessionProcess], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process_module, "SHUTDOWN_S", 0.5)

    def hang(pid: int) -> None:
        os.kill(pid, signal.SIGSTOP)
        signal.raise_signal(signal.SIGINT)

    begun_s = time.monotonic()
    session = shown(hang, "did not end")
    assert time.monotonic() - begun_s < PATIENCE_S
    assert not session.alive()


def attended(drive: Callable[[Feed, ClientConnection], Awaitable[None]]) -> None:
    """Serve a feed, and drive it and its page; what a page gets first is the greeting."""

    async def run() -> None:
        feed: Any = Feed()
        with listen("127.0.0.1", 0) as listening:
            async with PageServer(feed, Gate()).serving(listening):
                address = f"ws://127.0.0.1:{listening.getsockname()[1]}/socket"
                async with asyncio.timeout(PATIENCE_S), connect(address, proxy=None) as page:
                    assert await page.recv() == "{}"
                    await drive(feed, page)

    asyncio.run(run())


def test_a_stalled_page_gets_no_more_than_it_may_and_then_the_latest() -> None:
    async def drive(feed: Feed, page: ClientConnection) -> None:
        for number in range(UNACKNOWLEDGED):
            feed.frames.publish(bytes([number]))
            assert await page.recv() == bytes([number])
        for number in range(10, 50):
            feed.frames.publish(bytes([number]))
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(page.recv(), BRIEF_S)
        await page.send('{"ack": 1}')
        assert await page.recv() == bytes([49])

    attended(drive)


@pytest.mark.parametrize(
    "garbage", ["}{", '{"rm": 1}', b"\x00\xff" * 100, '{"seek_us": "x"}', "x" * 3000]
)
def test_garbage_ends_the_connection(garbage: str | bytes) -> None:
    async def drive(feed: Feed, page: ClientConnection) -> None:
        await page.send('{"seek_us": 7}')
        await page.send(garbage)
        with pytest.raises(ConnectionClosed):
            await page.recv()
        assert feed.commands == [("seek_us", 7)]

    attended(drive)


def test_pages_beyond_the_most_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "MOST_PAGES", 1)

    async def drive(feed: Feed, page: ClientConnection) -> None:
        with pytest.raises(InvalidStatus, match="503"):
            await connect(f"ws://127.0.0.1:{page.remote_address[1]}/socket", proxy=None)

    attended(drive)


def test_a_page_that_answers_nothing_is_hung_up_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "SILENT_S", 3 * BRIEF_S)

    async def drive(feed: Feed, page: ClientConnection) -> None:
        await asyncio.sleep(8 * BRIEF_S)  # one that waits for the first start is not silent
        feed.frames.publish(b"1")
        assert await page.recv() == b"1"
        with pytest.raises(ConnectionClosed):
            await page.recv()

    attended(drive)


def test_a_session_that_cannot_open_says_why() -> None:
    with closing(SessionProcess(open_nothing)) as session:
        wait_until(lambda: not session.alive())
        with pytest.raises(FileNotFoundError, match=r"nowhere\.raw"):
            session.receive()


ELSEWHERE = "192.0.2.1"  # An address of documentation (RFC 5737): no machine has it.


@pytest.mark.parametrize(
    ("named", "values"),
    [
        ("host", ("", "evil.example", "127.0.0.1.evil.example", "localhost.evil.example:8765",
                  "192.168.0.7:8765", "localhost:80; script-src *", "localhost:80@evil.example")),
        ("origin", ("http://evil.example", "null", "http://127.0.0.1:3000",
                    "http://localhost:8765", "file://")),
    ],
)  # fmt: skip
def test_other_hosts_and_foreign_origins_are_refused(named: str, values: tuple[str, ...]) -> None:
    for value in values:
        headers = {"host": "127.0.0.1:8765", named: value}
        assert named.title() in Gate().refusal(headers), value


def test_beyond_loopback_a_token_is_needed() -> None:
    gate = Gate.for_host("0.0.0.0")
    assert len(gate.token) >= 24
    headers = {"host": "lab.example:8765"}
    assert "token" in gate.refusal(headers)
    assert "token" in gate.refusal(headers, "ü" + gate.token[1:])
    assert gate.refusal(headers, gate.token) == ""
    assert "Origin" in gate.refusal({**headers, "origin": "http://evil.example"}, gate.token)
    assert Gate.for_host("0.0.0.0").token != gate.token


def test_an_address_that_cannot_be_served_on_is_refused_at_once() -> None:
    with listen("127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(DeviceError, match=f"{port} of 127.0.0.1 .*in use.*--port N"):
            listen("127.0.0.1", port)
    with pytest.raises(ConfigError, match=f"--host '{ELSEWHERE}' is no address of this machine"):
        listen(ELSEWHERE, 0)


def test_an_interrupt_that_comes_while_the_session_is_asked_is_not_lost() -> None:
    asked = 0

    def alive() -> bool:
        nonlocal asked
        asked += 1
        if asked == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return asked < 30

    serve(PageServer(cast(Any, Feed()), Gate()), listen("127.0.0.1", 0), alive)
    assert 3 <= asked < 30
