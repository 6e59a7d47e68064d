"""The page's server: one HTML page, its scripts, and one socket; bound to loopback by default.

Every page gets the latest frame that it can take; none slows another or the session.
"""

import asyncio
import json
import logging
import signal
import socket
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager, suppress
from http import HTTPStatus
from importlib import resources
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from websockets.asyncio import server as websockets
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from spikingtac.stream.ring import RingReader
from spikingtac.viewer.access import Gate, page_headers
from spikingtac.viewer.process import SessionProcess

KINDS = {"html": "text/html", "js": "text/javascript", "css": "text/css", "svg": "image/svg+xml"}
SOCKET = "/socket"
CLOSED_BY_POLICY = 1008  # WebSocket close code (RFC 6455 section 7.4.1).
SHUTDOWN_S = 1  # Wait for pages at the server's end, s: they never close by themselves.
ALIVE_S = 0.05  # How often the session is polled while serving, s.
REQUEST_S = 10.0  # Longest time from the start of a connection to a whole request, s.
POLL_S = 0.002  # How often the ring is polled, s; a tenth of a frame's time.
UNACKNOWLEDGED = 2  # Most frames on their way to a page; one is drawn while the next travels.
MOST_PAGES = 32  # Pages at a time.
SILENT_S = 60.0  # A page that acknowledges nothing for this long is disconnected, s.
LONGEST_COMMAND = 1024  # Characters; a page never needs more.
SLOWEST, FASTEST = 0.01, 10.0  # Speeds of playback, relative to the recording's own time.
SHORTEST_EXPOSURE_US, LONGEST_EXPOSURE_US = 500, 500_000
LATEST_US = 1 << 53  # Integers beyond it are not exact in a browser.

_LOG = logging.getLogger(__name__)
_LOG.disabled = True  # what a foreign client does wrong is nothing to the user


class CommandError(ValueError):
    """A message from a page that is no command."""


def parse_command(text: str) -> tuple[str, Any]:
    """Return ``(name, value)`` of a command.

    Commands are JSON objects of one key: ``ack``, ``play``, ``speed``, ``seek_us``,
    ``exposure_us``, ``map``, ``set`` (a list of a control's name and its value), ``defaults``,
    ``calibrate`` or ``begin_anew`` (the guide of a calibration).

    Raises:
        CommandError: The text is anything else.
    """
    try:
        ((name, value),) = json.loads(text if len(text) <= LONGEST_COMMAND else "").items()
        kinds, low, high = _RULES[name]
        control, given = "", value
        if name == "set":
            control, given = value if isinstance(value, list) else []
        fits = type(given) in kinds and (low is None or low <= given <= high)
        fits &= isinstance(control, str)
    except (ValueError, AttributeError, KeyError, TypeError, RecursionError) as error:
        raise CommandError("no JSON object of one known key") from error
    if not fits:
        raise CommandError(f"the value of {name!r} is out of range")
    return name, value


# Command -> types of its value, and its bounds; of a control the configuration knows them.
_RULES: dict[str, tuple[tuple[type, ...], Any, Any]] = {
    "ack": ((int,), 0, LATEST_US),
    "play": ((bool,), False, True),
    "speed": ((int, float), SLOWEST, FASTEST),
    "seek_us": ((int,), -LATEST_US, LATEST_US),
    "exposure_us": ((int,), SHORTEST_EXPOSURE_US, LONGEST_EXPOSURE_US),
    "map": ((bool,), False, True),
    "set": ((bool, int, float, str), None, None),
    **dict.fromkeys(("defaults", "calibrate", "begin_anew"), ((bool,), True, True)),
}


class Page:
    """One connected page.

    Args:
        session: What it shows.
        connection: Its socket.
    """

    def __init__(self, session: SessionProcess, connection: websockets.ServerConnection) -> None:
        self._session, self._connection = session, connection
        # Frames that it has not acknowledged. One that was sent none is not silent: the first start
        # compiles for a minute on a busy machine, and a page waits for it.
        self._on_the_way = 0
        self._since_s = 0.0  # of the last acknowledgement, or of the first frame on the way

    async def attend(self) -> None:
        """Serve the page until it leaves, stops acknowledging, or sends no valid command."""
        tasks = [asyncio.create_task(one) for one in (self._listen(), self._serve())]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await self._connection.close(CLOSED_BY_POLICY)

    async def _serve(self) -> None:
        """Send the latest greeting and frames as fast as the page acknowledges them."""
        frames, greetings = RingReader(self._session.frames), RingReader(self._session.greetings)
        loop = asyncio.get_running_loop()
        while not self._on_the_way or loop.time() - self._since_s < SILENT_S:
            if message := greetings.latest():
                await self._connection.send(message.decode())
            if self._on_the_way < UNACKNOWLEDGED and (message := frames.latest()):
                self._since_s = self._since_s if self._on_the_way else loop.time()
                self._on_the_way += 1
                await self._connection.send(message)
            await asyncio.sleep(POLL_S)

    async def _listen(self) -> None:
        """Take the page's commands until it leaves, or sends something else."""
        with suppress(CommandError, ConnectionClosed):
            async for message in self._connection:
                name, value = parse_command(message if isinstance(message, str) else "")
                if name == "ack":
                    self._on_the_way = max(self._on_the_way - 1, 0)
                    self._since_s = asyncio.get_running_loop().time()
                else:
                    self._session.tell((name, value))


class PageServer:
    """Answers requests for the page, its files and its socket.

    Args:
        session: What is shown.
        gate: Decides who may view.
    """

    def __init__(self, session: SessionProcess, gate: Gate) -> None:
        self._session, self._gate = session, gate

    def serving(self, listening: socket.socket) -> AbstractAsyncContextManager[object]:
        """Return a context during which pages are served; the socket is closed at its end."""
        return websockets.serve(
            lambda connection: Page(self._session, connection).attend(),
            sock=listening,
            process_request=self._answer,
            process_response=self._guard,
            logger=_LOG,
            open_timeout=REQUEST_S,
            close_timeout=SHUTDOWN_S,
            max_size=4 * LONGEST_COMMAND,
            compression=None,
            server_header=None,
        )

    def _answer(self, connection: websockets.ServerConnection, request: Request) -> Response | None:
        """Answer a request; None opens the socket."""
        headers = {key.lower(): value for key, value in request.headers.raw_items()}
        asked = urlsplit(request.path)
        path, name = asked.path, asked.path.removeprefix("/") or "index.html"
        # The scripts hold no data; the page that loads them has shown its token.
        guarded = path == SOCKET or name == "index.html"
        token = dict(parse_qsl(asked.query)).get("token") if guarded else self._gate.token
        if refusal := self._gate.refusal(headers, token):
            return connection.respond(HTTPStatus.FORBIDDEN, refusal + "\n")
        if path == SOCKET:
            busy = HTTPStatus.SERVICE_UNAVAILABLE, "too many pages are open\n"
            many = len(connection.server.connections) >= MOST_PAGES
            return connection.respond(*busy) if many else None
        kind = KINDS.get(name.rpartition(".")[2])
        file = resources.files("spikingtac.viewer") / "page" / name
        if kind is None or "/" in name or "\\" in name or not file.is_file():
            return connection.respond(HTTPStatus.NOT_FOUND, "not found\n")
        response = connection.respond(HTTPStatus.OK, file.read_text(encoding="utf-8"))
        del response.headers["Content-Type"]
        response.headers["Content-Type"] = f"{kind}; charset=utf-8"
        return response

    def _guard(
        self, connection: websockets.ServerConnection, request: Request, response: Response
    ) -> None:
        """Give every answer the security headers, for the own name only."""
        host = request.headers.get_all("Host")
        known = host[0] if len(host) == 1 and not self._gate.host_refusal(host[0]) else ""
        response.headers.update(page_headers(known))


def serve(
    server: PageServer,
    listening: socket.socket,
    alive: Callable[[], bool],
    ready: Callable[[], object] = lambda: None,
) -> None:
    """Serve until interrupted, or until the session has ended; the socket is closed then.

    Args:
        server: What is served.
        listening: A bound socket, from :func:`spikingtac.viewer.access.listen`.
        alive: Polled regularly; False ends the serving.
        ready: Called once the server answers.
    """

    async def run() -> None:
        ended, loop = asyncio.Event(), asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, ended.set)
        async with server.serving(listening):
            ready()
            while alive() and not ended.is_set():
                with suppress(TimeoutError):
                    await asyncio.wait_for(ended.wait(), ALIVE_S)

    with listening:
        asyncio.run(run())
