"""A viewer in a process of its own, as a user starts one."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from spikingtac.stream.host import Factory
from spikingtac.viewer.source import ViewSource
from spikingtac.viewer.web.access import Gate, listen
from spikingtac.viewer.web.process import SessionProcess
from spikingtac.viewer.web.server import make_app, serve

START_S = 180.0


def run_server(
    opener: Callable[..., ViewSource], arguments: dict[str, Any], token: str, port: Any
) -> None:
    session = SessionProcess(Factory(function=opener, arguments=arguments), repeat=True)
    app = make_app([session], [session.command], Gate(token=token))
    try:
        listening = listen("127.0.0.1", 0)
        port.put(listening.getsockname()[1])
        serve(app, listening, lambda: session.alive)
    finally:
        session.close()


@contextmanager
def served(opener: Callable[..., ViewSource], token: str = "", **arguments: Any) -> Iterator[int]:
    context = multiprocessing.get_context("spawn")
    port = context.Queue()
    process = context.Process(target=run_server, args=(opener, arguments, token, port))
    process.start()
    try:
        yield port.get(timeout=START_S)
    finally:
        process.terminate()
        process.join(60)
        if process.is_alive():
            process.kill()
