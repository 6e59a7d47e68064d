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


def run_server(opener: Callable[..., ViewSource], given: dict[str, Any], port: Any) -> None:
    session = SessionProcess(partial(opener, **given), repeat=True)
    try:
        listening = listen("127.0.0.1", 0)
        port.put(listening.getsockname()[1])
        serve(PageServer(session, Gate()), listening, session.alive)
    finally:
        session.close()


@contextmanager
def served(opener: Callable[..., ViewSource], **arguments: Any) -> Iterator[int]:
    """Serve a view, and yield the port."""
    context = multiprocessing.get_context("spawn")
    port = context.Queue()
    process = context.Process(target=run_server, args=(opener, arguments, port))
    process.start()
    try:
        yield port.get(timeout=START_S)
    finally:
        process.terminate()
        process.join(60)
        if process.is_alive():
            process.kill()
