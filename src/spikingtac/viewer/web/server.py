"""The page's server: one HTML page, its scripts, and one socket; bound to loopback by default."""

from __future__ import annotations

import asyncio
import signal
import socket
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager, suppress
from importlib import resources
from typing import Any

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

from spikingtac.viewer.web.access import Gate, page_headers
from spikingtac.viewer.web.page_feed import MOST_PAGES, Feed, Page, PageFeeds
from spikingtac.viewer.web.wire import LONGEST_COMMAND, CommandError, parse_command

KINDS = {
    "html": "text/html; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "svg": "image/svg+xml",
}
FINGER = "finger"  # Parameter of an address that names one of two sessions.
CLOSED_BY_POLICY = 1008  # WebSocket close code (RFC 6455 section 7.4.1).
SHUTDOWN_S = 1  # Pages never close by themselves, so the server does not wait for them at its end.
ALIVE_S = 0.05  # How often the session is polled while serving.

# Longest time from the start of a connection, or the last answer, to the next whole request, s.
REQUEST_S = 10.0
_INCOMPLETE = (h11.IDLE, h11.SEND_BODY)

Command = Callable[[str, Any], None]


def make_app(given: Sequence[Feed], commands: Sequence[Command], gate: Gate) -> ASGIApp:
    """Return the application that shows one session, or two side by side.

    The first page of two holds two ordinary ones, each with the number of its finger in its
    address.

    Args:
        given: Where frames and greetings of each come from.
        commands: Take the commands of each one's pages; must not wait.
        gate: Decides who may view.
    """
    every = [PageFeeds(feed) for feed in given]

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        polling = [asyncio.create_task(feeds.poll()) for feeds in every]
        yield
        for task in polling:
            task.cancel()
        await asyncio.gather(*polling, return_exceptions=True)

    async def serve_file(request: Request) -> Response:
        name = request.path_params.get("name") or _first_page(request, len(every))
        # The scripts hold no data; the page that loads them has shown its token.
        refusal = "" if name != "index.html" and gate.token else _refusal(gate, request)
        return PlainTextResponse(refusal + "\n", 403) if refusal else _file(name)

    async def serve_socket(socket: WebSocket) -> None:
        if refusal := _refusal(gate, socket):
            await socket.send_denial_response(PlainTextResponse(refusal + "\n", 403))
            return
        finger = _finger(socket, len(every))
        if len(every[finger].pages) >= MOST_PAGES:
            await socket.send_denial_response(PlainTextResponse("too many pages are open\n", 503))
            return
        await socket.accept()
        await _attend(every[finger], socket, commands[finger])

    routes = [
        Route("/", serve_file),
        Route("/{name}", serve_file),
        WebSocketRoute("/socket", serve_socket),
    ]
    return _Guarded(Starlette(routes=routes, lifespan=lifespan), gate, framed=len(every) > 1)


def _first_page(request: Request, sessions: int) -> str:
    return "index.html" if sessions == 1 or FINGER in request.query_params else "pair.html"


def _finger(connection: HTTPConnection, sessions: int) -> int:
    """Return which session a page asks for; the first one where it asks for none that is there."""
    asked = connection.query_params.get(FINGER, "0")
    return int(asked) if asked.isdecimal() and int(asked) < sessions else 0


class _Guarded:
    """An application whose every answer has the security headers, and that knows its own name only.

    Args:
        app: Answers the requests whose Host is accepted.
        gate: Decides about the Host.
        framed: Whether one of its pages holds others.
    """

    def __init__(self, app: ASGIApp, gate: Gate, framed: bool = False) -> None:
        self._app, self._gate, self._framed = app, gate, framed

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        host = Headers(scope=scope).get("host", "")
        refusal = self._gate.host_refusal(host)
        headers = page_headers("" if refusal else host, self._framed)

        async def send_guarded(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                MutableHeaders(scope=message).update(headers)
            await send(message)

        if refusal and scope["type"] == "http":
            await PlainTextResponse(refusal + "\n", 403)(scope, receive, send_guarded)
        else:  # a socket is refused by its route
            await self._app(scope, receive, send_guarded)


async def _attend(feeds: PageFeeds, socket: WebSocket, command: Command) -> None:
    """Serve one page until it leaves, stops acknowledging, or sends no valid command."""
    page = Page()
    feeds.pages.add(page)
    listening = asyncio.create_task(_listen(socket, page, command))
    serving = asyncio.create_task(feeds.serve(page, socket.send_text, socket.send_bytes))
    try:
        await asyncio.wait((listening, serving), return_when=asyncio.FIRST_COMPLETED)
    finally:
        feeds.pages.discard(page)
        for task in (listening, serving):
            task.cancel()
        await asyncio.gather(listening, serving, return_exceptions=True)
        with suppress(RuntimeError, WebSocketDisconnect):
            await socket.close(CLOSED_BY_POLICY)


async def _listen(socket: WebSocket, page: Page, command: Command) -> None:
    while True:
        message = await socket.receive()
        if message["type"] == "websocket.disconnect":
            return
        try:
            name, value = parse_command(message.get("text") or "")
        except CommandError:
            return
        if name == "ack":
            page.acknowledge()
        else:
            command(name, value)


def _refusal(gate: Gate, connection: HTTPConnection) -> str:
    headers = {key.lower(): value for key, value in connection.headers.items()}
    return gate.refusal(headers, connection.query_params.get("token"))


def _file(name: str) -> Response:
    kind = KINDS.get(name.rpartition(".")[2])
    source = resources.files("spikingtac.viewer.web") / "page" / name
    if kind is None or "/" in name or "\\" in name or not source.is_file():
        return PlainTextResponse("not found\n", 404)
    return Response(source.read_bytes(), media_type=kind)


class DeadlineProtocol(H11Protocol):
    """uvicorn's HTTP protocol with a deadline for each request; single bytes do not extend it."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for the first request."""
        super().connection_made(transport)
        self._watch()

    def data_received(self, data: bytes) -> None:
        """Take bytes of a request."""
        super().data_received(data)
        self._watch()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Hand the connection over to the socket's protocol, which has its own time limits."""
        self._cancel()
        super().handle_websocket_upgrade(event)

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        super().on_response_complete()
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the deadline."""
        self._cancel()
        super().connection_lost(exc)

    def _watch(self) -> None:
        if self.conn.their_state not in _INCOMPLETE or self.transport.get_protocol() is not self:
            self._cancel()
        elif self._deadline is None and not self.transport.is_closing():
            self._deadline = self.loop.call_later(REQUEST_S, self.transport.abort)

    def _cancel(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


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
        listening: A bound socket, from :func:`spikingtac.viewer.web.access.listen`.
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
