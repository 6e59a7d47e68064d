"""Send every page the latest frame that it can take; none slows another or the session."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Protocol

POLL_S = 0.002  # How often the ring is polled; a tenth of a frame's time.
UNACKNOWLEDGED = 2  # Most frames on their way to a page; one is drawn while the next travels.
WAKE_S = 1.0  # How often a page without frames is checked.
MOST_PAGES = 32
SILENT_S = 60.0  # A page that acknowledges nothing for this long is disconnected.


class Feed(Protocol):
    """Where frames and greetings come from."""

    def frame(self, after: int) -> tuple[int, bytes] | None:
        """Return the latest frame after a number, or None."""
        ...

    def greeting(self, after: int) -> tuple[int, bytes] | None:
        """Return the latest greeting after a number, or None."""
        ...


class Page:
    """One connected page: what it was sent and what it has drawn."""

    def __init__(self) -> None:
        self.wake = asyncio.Event()
        self.acknowledged_s = asyncio.get_running_loop().time()
        self._sent = 0
        self._on_the_way = 0

    @property
    def ready(self) -> bool:
        """True while it may be sent another frame."""
        return self._on_the_way < UNACKNOWLEDGED

    @property
    def silent_s(self) -> float:
        """How long it has left a frame unacknowledged, s; a page that was sent none is not silent.

        The first start compiles for a minute on a busy machine, and a page waits for it.
        """
        now_s = asyncio.get_running_loop().time()
        return now_s - self.acknowledged_s if self._on_the_way else 0.0

    def sent(self) -> None:
        """Note that a frame went out."""
        if not self._on_the_way:
            self.acknowledged_s = asyncio.get_running_loop().time()
        self._sent += 1
        self._on_the_way += 1

    def acknowledge(self) -> None:
        """Note that the page has drawn a frame."""
        self._on_the_way = max(self._on_the_way - 1, 0)
        self.acknowledged_s = asyncio.get_running_loop().time()
        self.wake.set()


class PageFeeds:
    """Keeps the latest frame and greeting, and the connected pages.

    Attributes:
        frame: ``(number, message)`` of the latest frame.
        greeting: The same of the latest greeting.
        pages: The connected pages.
    """

    def __init__(self, feed: Feed) -> None:
        self.frame: tuple[int, bytes] = (0, b"")
        self.greeting: tuple[int, bytes] = (0, b"")
        self.pages: set[Page] = set()
        self._feed = feed

    async def poll(self) -> None:
        """Follow the feed until cancelled."""
        while True:
            frame, greeting = self._feed.frame(self.frame[0]), self._feed.greeting(self.greeting[0])
            self.frame, self.greeting = frame or self.frame, greeting or self.greeting
            if frame or greeting:
                for page in self.pages:
                    page.wake.set()
            await asyncio.sleep(POLL_S)

    async def serve(
        self,
        page: Page,
        send_text: Callable[[str], Awaitable[None]],
        send_bytes: Callable[[bytes], Awaitable[None]],
    ) -> None:
        """Send a page the latest greeting and frames as fast as it acknowledges them.

        Returns when the page has been silent for :data:`SILENT_S`.
        """
        greeted = framed = 0
        while page.silent_s < SILENT_S:
            if self.greeting[0] > greeted:
                greeted, message = self.greeting
                await send_text(message.decode())
            if page.ready and self.frame[0] > framed:
                framed, message = self.frame
                page.sent()
                await send_bytes(message)
                continue
            page.wake.clear()
            # Not wait_for: in Python 3.11 it may swallow a cancellation that meets a wake-up.
            with suppress(TimeoutError):
                async with asyncio.timeout(WAKE_S):
                    await page.wake.wait()
