"""Standard input as a named pipe, so that another process can read it."""

from __future__ import annotations

import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from spikingtac.errors import DeviceError, RecordingError

CHUNK_BYTES = 1 << 16
"""Bytes that are passed on at once: what a pipe holds."""


@contextmanager
def standard_input_pipe() -> Iterator[Path]:
    """Pass standard input on through a named pipe while the block runs.

    Yields:
        The pipe's path.

    Raises:
        RecordingError: Standard input is a terminal.
        DeviceError: The system has no named pipes.
    """
    if sys.stdin.isatty():
        raise RecordingError(
            "standard input is a terminal; pipe RAW events into it: ... | spikingtac view -"
        )
    if not hasattr(os, "mkfifo"):
        raise DeviceError("this system has no named pipes; record into a file, and view that")
    with tempfile.TemporaryDirectory(prefix="spikingtac-stdin-") as folder:
        pipe = Path(folder) / "standard-input"
        os.mkfifo(pipe)
        # A daemon: it ends with this process, whatever it waits for.
        threading.Thread(target=_pass_on, args=(pipe,), daemon=True).start()
        yield pipe


def _pass_on(pipe: Path) -> None:
    with suppress(BrokenPipeError, FileNotFoundError), pipe.open("wb", buffering=0) as file:
        while data := os.read(sys.stdin.fileno(), CHUNK_BYTES):
            _write_all(file.fileno(), data)


def _write_all(number: int, data: bytes) -> None:
    while data:
        data = data[os.write(number, data) :]
