"""Two sessions on one page: what is asked of time goes to both, everything else to one."""

from __future__ import annotations

import json
from typing import Any

import httpx
import pytest

from spikingtac.viewer.web.access import Gate
from spikingtac.viewer.web.server import make_app
from spikingtac.viewer.web.show import Together


class Session:
    """Keeps its commands; its recording lasts from ``first_us`` to ``last_us``."""

    def __init__(self, first_us: int, last_us: int) -> None:
        self.commands: list[tuple[str, Any]] = []
        self.overview: dict[str, int] | None = {"t_start_us": first_us, "t_end_us": last_us}

    def command(self, name: str, value: Any) -> None:
        self.commands.append((name, value))

    def greeting(self, after: int) -> tuple[int, bytes]:
        return 1, json.dumps({"overview": self.overview} if self.overview else {}).encode()

    def frame(self, after: int) -> None:
        return None


def pair() -> list[Session]:
    return [Session(100, 900), Session(300, 1_200)]


def test_on_one_clock_both_begin_at_and_go_to_the_same_time() -> None:
    sessions: Any = pair()
    together = Together(sessions, one_clock=True)
    together.begin()
    together.begin()
    together.commands[1]("seek_us", 500)
    together.commands[0]("seek_us", 100)
    together.commands[0]("seek_us", 2_000)
    together.commands[1]("play", False)
    together.commands[0]("map", True)
    shared = [
        ("seek_us", 300),
        ("seek_us", 500),
        ("seek_us", 300),
        ("seek_us", 900),
        ("play", False),
    ]
    assert sessions[1].commands == shared
    assert sessions[0].commands == [*shared, ("map", True)]


def test_on_clocks_of_their_own_a_time_is_meant_for_one() -> None:
    sessions: Any = pair()
    together = Together(sessions, one_clock=False)
    together.begin()
    together.commands[0]("seek_us", 2_000)
    together.commands[1]("speed", 0.5)
    assert sessions[0].commands == [("seek_us", 2_000), ("speed", 0.5)]
    assert sessions[1].commands == [("speed", 0.5)]


@pytest.mark.parametrize("token", ["", "secret"])
def test_the_first_page_holds_both_and_only_own_pages_may_be_framed(token: str) -> None:
    sessions: Any = pair()
    app = make_app(sessions, Together(sessions, one_clock=False).commands, Gate(token=token))

    async def asked(path: str) -> httpx.Response:
        transport = httpx.ASGITransport(app=app)
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
            return await client.get(path)

    import asyncio

    first = asyncio.run(asked("/"))
    assert first.status_code == 200
    assert "Second finger" in first.text
    policy = first.headers["content-security-policy"]
    assert "frame-ancestors 'self'" in policy
    assert "frame-src 'self'" in policy
    one = asyncio.run(asked(f"/?finger=1&token={token}"))
    assert 'id="sensor"' in one.text
    assert asyncio.run(asked("/?finger=1&token=wrong")).status_code == (403 if token else 200)
