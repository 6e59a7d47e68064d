"""A viewer in a process of its own, as a user starts one."""

import multiprocessing
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from spikingtac.viewer.access import Gate, listen
from spikingtac.viewer.process import SessionProcess
from spikingtac.viewer.server import PageServer, serve
from spikingtac.viewer.source import ViewSource

START_S = 180.0


def run_server(opener: Callable[..., ViewSource], given: list[dict[str, Any]], port: Any) -> None:
    views = [partial(opener, **arguments) for arguments in given]
    sessions = [SessionProcess(view, repeat=True) for view in views]
    try:
        listening = listen("127.0.0.1", 0)
        port.put(listening.getsockname()[1])
        server = PageServer(sessions, Gate())
        serve(server, listening, lambda: all(session.alive() for session in sessions))
    finally:
        for session in sessions:
            session.close()


@contextmanager
def served(
    opener: Callable[..., ViewSource], second: dict[str, Any] | None = None, **arguments: Any
) -> Iterator[int]:
    """Serve a view, and yield the port; ``second`` are the arguments of another one beside it."""
    context = multiprocessing.get_context("spawn")
    port = context.Queue()
    process = context.Process(
        target=run_server, args=(opener, [arguments, *([second] if second else [])], port)
    )
    process.start()
    try:
        yield port.get(timeout=START_S)
    finally:
        process.terminate()
        process.join(60)
        if process.is_alive():
            process.kill()
