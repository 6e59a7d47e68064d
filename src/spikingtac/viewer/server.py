"""The page's server: one HTML page, its scripts, and one socket; bound to loopback by default.

Every page gets the latest frame that it can take; none slows another or the session.
"""

from __future__ import annotations

import asyncio
import signal
import socket
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager, suppress
from functools import partial
from importlib import resources

import h11
import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol

from spikingtac.viewer.access import Gate, page_headers
from spikingtac.viewer.process import SessionProcess
from spikingtac.viewer.wire import LONGEST_COMMAND, CommandError, parse_command

KINDS = {"html": "text/html", "js": "text/javascript", "css": "text/css", "svg": "image/svg+xml"}
FINGER = "finger"  # Parameter of an address that names one of two sessions.
CLOSED_BY_POLICY = 1008  # WebSocket close code (RFC 6455 section 7.4.1).
SHUTDOWN_S = 1  # Wait for pages at the server's end, s: they never close by themselves.
ALIVE_S = 0.05  # How often the session is polled while serving, s.

# Longest time from the start of a connection, or the last answer, to the next whole request, s.
REQUEST_S = 10.0
POLL_S = 0.002  # How often the ring is polled, s; a tenth of a frame's time.
UNACKNOWLEDGED = 2  # Most frames on their way to a page; one is drawn while the next travels.
WAKE_S = 1.0  # How often a page without frames is checked, s.
MOST_PAGES = 32
SILENT_S = 60.0  # A page that acknowledges nothing for this long is disconnected, s.


class Page:
    """One connected page.

    Attributes:
        wake: Set when there may be something to send.
        on_the_way: Frames that it has not acknowledged. One that was sent none is not silent: the
            first start compiles for a minute on a busy machine, and a page waits for it.
        since_s: When it last acknowledged a frame, or got the first of those on the way, s.
    """

    def __init__(self) -> None:
        self.wake = asyncio.Event()
        self.on_the_way, self.since_s = 0, 0.0

    def acknowledge(self) -> None:
        """Note that the page has drawn a frame."""
        self.on_the_way = max(self.on_the_way - 1, 0)
        self.since_s = asyncio.get_running_loop().time()
        self.wake.set()


class PageFeeds:
    """The latest frame and greeting of a session, and the pages that follow it."""

    def __init__(self, session: SessionProcess) -> None:
        self.session, self.pages = session, set[Page]()
        self._frame = self._greeting = (0, b"")

    async def poll(self) -> None:
        """Follow the session until cancelled."""
        while True:
            frame = self.session.frame(self._frame[0])
            greeting = self.session.greeting(self._greeting[0])
            self._frame, self._greeting = frame or self._frame, greeting or self._greeting
            if frame or greeting:
                for page in self.pages:
                    page.wake.set()
            await asyncio.sleep(POLL_S)

    async def serve(self, page: Page, socket: WebSocket) -> None:
        """Send a page the latest greeting and frames as fast as it acknowledges them.

        Returns when the page has been silent for :data:`SILENT_S`.
        """
        greeted = framed = 0
        loop = asyncio.get_running_loop()
        while not page.on_the_way or loop.time() - page.since_s < SILENT_S:
            if self._greeting[0] > greeted:
                greeted, message = self._greeting
                await socket.send_text(message.decode())
            if page.on_the_way < UNACKNOWLEDGED and self._frame[0] > framed:
                framed, message = self._frame
                page.since_s = page.since_s if page.on_the_way else loop.time()
                page.on_the_way += 1
                await socket.send_bytes(message)
                continue
            page.wake.clear()
            # Not wait_for: in Python 3.11 it may swallow a cancellation that meets a wake-up.
            with suppress(TimeoutError):
                async with asyncio.timeout(WAKE_S):
                    await page.wake.wait()

    async def attend(self, socket: WebSocket) -> None:
        """Serve a page until it leaves, stops acknowledging, or sends no valid command."""
        page = Page()
        self.pages.add(page)
        tasks = [
            asyncio.create_task(self._listen(socket, page)),
            asyncio.create_task(self.serve(page, socket)),
        ]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self.pages.discard(page)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            with suppress(RuntimeError, WebSocketDisconnect):
                await socket.close(CLOSED_BY_POLICY)

    async def _listen(self, socket: WebSocket, page: Page) -> None:
        while (message := await socket.receive())["type"] != "websocket.disconnect":
            try:
                name, value = parse_command(message.get("text") or "")
            except CommandError:
                return
            if name == "ack":
                page.acknowledge()
            else:
                self.session.command(name, value)


def make_app(sessions: Sequence[SessionProcess], gate: Gate) -> ASGIApp:
    """Return the application that shows one session, or two side by side.

    The first page of two holds two ordinary ones, each with the number of its finger in its
    address.

    Args:
        sessions: What is shown.
        gate: Decides who may view.
    """
    every = [PageFeeds(session) for session in sessions]

    def refusal(connection: HTTPConnection) -> str:
        headers = {key.lower(): value for key, value in connection.headers.items()}
        return gate.refusal(headers, connection.query_params.get("token"))

    async def serve_file(request: Request) -> Response:
        pair = len(every) > 1 and FINGER not in request.query_params
        name = request.path_params.get("name") or ("pair.html" if pair else "index.html")
        # The scripts hold no data; the page that loads them has shown its token.
        why = "" if name != "index.html" and gate.token else refusal(request)
        if why:
            return PlainTextResponse(why + "\n", 403)
        kind = KINDS.get(name.rpartition(".")[2])
        file = resources.files("spikingtac.viewer") / "page" / name
        if kind is None or "/" in name or "\\" in name or not file.is_file():
            return PlainTextResponse("not found\n", 404)
        return Response(file.read_bytes(), media_type=kind)

    async def serve_socket(socket: WebSocket) -> None:
        asked = socket.query_params.get(FINGER, "0")
        feeds = every[int(asked) if asked in map(str, range(len(every))) else 0]
        why = refusal(socket)
        if why or len(feeds.pages) >= MOST_PAGES:
            told = PlainTextResponse(f"{why or 'too many pages are open'}\n", 403 if why else 503)
            await socket.send_denial_response(told)
            return
        await socket.accept()
        await feeds.attend(socket)

    routes = [
        Route("/", serve_file),
        Route("/{name}", serve_file),
        WebSocketRoute("/socket", serve_socket),
    ]
    return _guarded(
        Starlette(routes=routes, lifespan=partial(_polling, every)), gate, framed=len(every) > 1
    )


@asynccontextmanager
async def _polling(every: Sequence[PageFeeds], app: Starlette) -> AsyncIterator[None]:
    """Follow the sessions while the application runs."""
    tasks = [asyncio.create_task(feeds.poll()) for feeds in every]
    yield
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


def _guarded(app: ASGIApp, gate: Gate, framed: bool) -> ASGIApp:
    """Return an application whose every answer has the security headers, for its own name only.

    Args:
        app: Answers the requests whose Host is accepted.
        gate: Decides about the Host.
        framed: Whether one of its pages holds others.
    """

    async def guarded(scope: Scope, receive: Receive, send: Send) -> None:
        host = Headers(scope=scope).get("host", "") if "headers" in scope else ""
        refusal = gate.host_refusal(host)
        headers = page_headers("" if refusal else host, framed)

        async def send_guarded(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                MutableHeaders(scope=message).update(headers)
            await send(message)

        if refusal and scope["type"] == "http":  # a socket is refused by its route
            await PlainTextResponse(refusal + "\n", 403)(scope, receive, send_guarded)
        else:
            await app(scope, receive, send_guarded)

    return guarded


class DeadlineProtocol(H11Protocol):
    """uvicorn's HTTP protocol with a deadline for each request; single bytes do not extend it."""

    _answered = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for the first request."""
        super().connection_made(transport)
        self.loop.call_later(REQUEST_S, self._hang_up, 0)

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        super().on_response_complete()
        self._answered += 1
        self.loop.call_later(REQUEST_S, self._hang_up, self._answered)

    def _hang_up(self, answered: int) -> None:
        """End a connection whose next request is not whole; a web socket has its own limits."""
        waiting = self.conn.their_state in (h11.IDLE, h11.SEND_BODY)
        if waiting and answered == self._answered and self.transport.get_protocol() is self:
            self.transport.abort()


class _Server(uvicorn.Server):
    """Ends quietly at a signal; uvicorn's own server repeats it, which skips the clean-up."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        numbers = (signal.SIGINT, signal.SIGTERM)
        before = {number: signal.signal(number, self.handle_exit) for number in numbers}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def serve(
    app: ASGIApp,
    listening: socket.socket,
    alive: Callable[[], bool],
    ready: Callable[[], object] = lambda: None,
) -> None:
    """Serve until interrupted, or until the session has ended; the socket is closed then.

    Args:
        app: From :func:`make_app`.
        listening: A bound socket, from :func:`spikingtac.viewer.access.listen`.
        alive: Polled regularly; False ends the serving.
        ready: Called once the server answers, and ends at a signal.
    """
    config = uvicorn.Config(
        app,
        http=DeadlineProtocol,
        log_level="critical",  # errors are raised or sent to the page
        ws="websockets-sansio",
        ws_max_size=4 * LONGEST_COMMAND,
        ws_per_message_deflate=False,
        server_header=False,
        timeout_graceful_shutdown=SHUTDOWN_S,
    )
    server = _Server(config)

    async def run() -> None:
        serving = asyncio.create_task(server.serve([listening]))
        while not server.started and not serving.done():
            await asyncio.sleep(0.01)
        ready()
        while not serving.done():
            if not alive():  # a signal may set it meanwhile: nothing is written back
                server.should_exit = True
            await asyncio.wait((serving,), timeout=ALIVE_S)
        await serving

    with listening:
        asyncio.run(run())
