"""Every answer carries the security headers; no request and no silent page is waited for."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import Callable
from typing import Any

import httpx
import pytest
import uvicorn
from starlette.types import ASGIApp
from uvicorn.server import ServerState

from spikingtac.errors import DeviceError
from spikingtac.stream.host import Factory
from spikingtac.viewer import process, server
from spikingtac.viewer import show as show_module
from spikingtac.viewer.access import Gate
from spikingtac.viewer.process import SessionProcess
from spikingtac.viewer.server import DeadlineProtocol, Page, PageFeeds, make_app
from spikingtac.viewer.show import PageOptions, show
from stand_ins.viewer import open_circling

pytestmark = pytest.mark.waits

LOCAL = "http://127.0.0.1:8765"
PATIENCE_S = 60.0
BRIEF_S = 0.05


class Feed:
    """A session that greets at once where it has frames; its first frame may come late."""

    def __init__(self) -> None:
        self.number = 0

    def frame(self, after: int) -> tuple[int, bytes] | None:
        return (self.number, b"frame") if self.number > after else None

    def greeting(self, after: int) -> tuple[int, bytes] | None:
        return (1, b"{}") if after < 1 else None


def app(token: str = "", sessions: int = 1) -> ASGIApp:
    feeds: Any = [Feed() for _ in range(sessions)]
    return make_app(feeds, Gate(token=token))


def ask(path: str, served: ASGIApp | None = None, **options: Any) -> httpx.Response:
    async def run() -> httpx.Response:
        transport = httpx.ASGITransport(served or app())
        async with httpx.AsyncClient(transport=transport, base_url=LOCAL) as client:
            return await client.get(path, **options)

    return asyncio.run(run())


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        ("/", {}, 200),
        ("/missing.js", {}, 404),
        ("/no/such/path", {}, 404),
        ("/", {"origin": "http://evil.example"}, 403),
        ("/", {"host": "evil.example"}, 403),
        ("/viewer.js", {"host": "evil.example; script-src *"}, 403),
    ],
)
def test_every_answer_carries_the_security_headers(
    path: str, headers: dict[str, str], status: int
) -> None:
    answer = ask(path, headers=headers)
    assert answer.status_code == status
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("default-src 'none'")
    assert "evil" not in policy
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["cache-control"] == "no-store"


@pytest.mark.parametrize("token", ["", "s3cret"])
@pytest.mark.parametrize("path", ["/", "/viewer.js", "/missing.js"])
def test_a_request_without_host_is_refused_and_enters_no_policy(token: str, path: str) -> None:
    sent: list[Any] = []

    async def ask() -> None:
        scope = {
            "type": "http", "method": "GET", "path": path, "raw_path": path.encode(),
            "query_string": b"token=s3cret", "headers": [], "http_version": "1.0", "root_path": "",
        }  # fmt: skip

        async def receive() -> dict[str, Any]:
            return {"type": "http.request", "body": b""}

        async def send(message: Any) -> None:
            sent.append(message)

        await app(token)(scope, receive, send)

    asyncio.run(ask())
    assert sent[0]["status"] == 403
    headers = dict(sent[0]["headers"])
    assert b"ws://" not in headers[b"content-security-policy"]


def exchange(sent: list[bytes], monkeypatch: pytest.MonkeyPatch, pause_s: float) -> bytes:
    """Send pieces to a server with a deadline of 0.3 s; return what came until it hung up."""
    monkeypatch.setattr(server, "REQUEST_S", 0.3)
    monkeypatch.setattr(asyncio.StreamWriter, "__del__", lambda self: None, raising=False)

    async def run() -> bytes:
        config = uvicorn.Config(app(), log_level="critical", timeout_keep_alive=60)
        config.load()
        state = ServerState()
        server = await asyncio.get_running_loop().create_server(
            lambda: DeadlineProtocol(config, state, {}), "127.0.0.1", 0
        )
        port = server.sockets[0].getsockname()[1]
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        try:
            for piece in sent:
                writer.write(piece)
                await asyncio.sleep(pause_s)
            return await asyncio.wait_for(reader.read(), PATIENCE_S)
        except ConnectionError:
            return b""
        finally:
            writer.transport.abort()
            server.close()

    return asyncio.run(run())


REQUEST = b"GET /missing.js HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"


@pytest.mark.parametrize("half", [b"", b"GET /viewer.js HT", REQUEST[:-2]])
def test_a_half_sent_request_is_hung_up_on(half: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    assert exchange([half], monkeypatch, 0.0) == b""


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
        options = PageOptions(port=0, browser=False, seconds=PATIENCE_S)
        view = Factory(function=open_circling, arguments={"duration_us": 300_000})
        with pytest.raises(DeviceError, match=failure):
            show([view], options, ready)
        return made[0]

    return run


def test_a_session_that_was_killed_is_a_failure(shown: Callable[..., SessionProcess]) -> None:
    shown(lambda pid: os.kill(pid, signal.SIGKILL), "was killed")


def test_ctrl_c_ends_a_session_that_hangs(
    shown: Callable[..., SessionProcess], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "SHUTDOWN_S", 0.5)

    def hang(pid: int) -> None:
        os.kill(pid, signal.SIGSTOP)
        signal.raise_signal(signal.SIGINT)

    begun_s = time.monotonic()
    session = shown(hang, "did not end")
    assert time.monotonic() - begun_s < PATIENCE_S
    assert not session.alive


@pytest.mark.parametrize("token", ["", "secret"])
def test_the_page_of_two_holds_both_and_only_own_pages_may_be_framed(token: str) -> None:
    pair = app(token, sessions=2)
    first = ask("/", pair)
    assert first.status_code == 200
    assert "Second finger" in first.text
    policy = first.headers["content-security-policy"]
    assert "frame-ancestors 'self'" in policy
    assert "frame-src 'self'" in policy
    assert 'id="sensor"' in ask(f"/?finger=1&token={token}", pair).text
    assert ask("/?finger=1&token=wrong", pair).status_code == (403 if token else 200)


class Answering:
    """A page's socket that acknowledges every frame, or none."""

    def __init__(self, page: Page, answers: bool) -> None:
        self.page, self.answers = page, answers

    async def send_bytes(self, _: bytes) -> None:
        if self.answers:
            self.page.acknowledge()

    async def send_text(self, _: str) -> None:
        return


async def lasted(wait_s: float, *, frames: int, answers: bool) -> bool:
    """Return whether a page is still served after a wait without frames, and after its frames."""
    feed: Any = Feed()
    feeds, page = PageFeeds(feed), Page()
    socket: Any = Answering(page, answers)
    tasks = [asyncio.create_task(feeds.poll()), asyncio.create_task(feeds.serve(page, socket))]
    feeds.pages.add(page)
    await asyncio.sleep(wait_s)
    for number in range(1, frames + 1):
        feed.number = number
        await asyncio.sleep(BRIEF_S)
    served = not tasks[1].done()
    for task in tasks:
        task.cancel()
    return served


@pytest.mark.parametrize(
    ("wait_s", "frames", "answers", "served"),
    [(8 * BRIEF_S, 1, True, True), (8 * BRIEF_S, 0, True, True), (0.0, 8, False, False)],
)
def test_who_is_hung_up_on(
    wait_s: float, frames: int, answers: bool, served: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "SILENT_S", 3 * BRIEF_S)
    monkeypatch.setattr(server, "WAKE_S", BRIEF_S)
    assert asyncio.run(lasted(wait_s, frames=frames, answers=answers)) is served
