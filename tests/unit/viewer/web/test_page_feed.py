"""A page that leaves a frame unanswered is silent; one that waits for the first start is not."""

from __future__ import annotations

import asyncio

import pytest

from spikingtac.viewer.web import page_feed
from spikingtac.viewer.web.page_feed import Page, PageFeeds

BRIEF_S = 0.05


class LateFeed:
    """Greets at once; its first frame may come late."""

    def __init__(self) -> None:
        self.number = 0

    def frame(self, after: int) -> tuple[int, bytes] | None:
        return (self.number, b"frame") if self.number > after else None

    def greeting(self, after: int) -> tuple[int, bytes] | None:
        return (1, b"{}") if after < 1 else None


async def lasted(wait_s: float, *, frames: int, answers: bool) -> bool:
    """Return whether a page is still served after a wait without frames, and after its frames."""
    feed = LateFeed()
    feeds, page = PageFeeds(feed), Page()

    async def take(_: object) -> None:
        if answers:
            page.acknowledge()

    async def greet(_: object) -> None:
        return

    tasks = [
        asyncio.create_task(feeds.poll()),
        asyncio.create_task(feeds.serve(page, greet, take)),
    ]
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
    monkeypatch.setattr(page_feed, "SILENT_S", 3 * BRIEF_S)
    monkeypatch.setattr(page_feed, "WAKE_S", BRIEF_S)
    assert asyncio.run(lasted(wait_s, frames=frames, answers=answers)) is served
