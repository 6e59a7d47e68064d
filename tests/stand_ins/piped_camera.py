"""A camera that writes RAW into a named pipe: a file's bytes, at once or as time passes."""

import os
import threading
import time
from pathlib import Path

import numpy as np


class PipedCamera:
    """Writes a file into a new pipe from a thread; pieces have odd lengths, as USB's do."""

    def __init__(self, pipe: Path, data: bytes, *, lasting_s: float = 0.0, pieces: int = 40):
        os.mkfifo(pipe)
        self._pipe, self._data, self._lasting_s, self._pieces = pipe, data, lasting_s, pieces
        self.go_on = threading.Event()
        self.go_on.set()
        self.written = 0
        self._thread = threading.Thread(target=self._write, daemon=True)
        self._thread.start()

    def pause_after(self, share: float) -> None:
        """Hold back what follows this share of the file until ``go_on`` is set."""
        self._hold = int(share * len(self._data))
        self.go_on.clear()

    _hold = 0

    def _write(self) -> None:
        cuts = np.sort(np.random.default_rng(0).integers(1, len(self._data), self._pieces)).tolist()
        begun_s = None
        try:
            with self._pipe.open("wb", buffering=0) as file:
                for start, end in zip([0, *cuts], [*cuts, len(self._data)], strict=True):
                    if start >= self._hold:
                        self.go_on.wait(60.0)
                    begun_s = begun_s or time.monotonic()
                    due_s = begun_s + self._lasting_s * start / len(self._data)
                    time.sleep(max(due_s - time.monotonic(), 0.0))
                    file.write(self._data[start:end])
                    self.written = end
        except BrokenPipeError:
            return  # the reader has seen enough

    def join(self) -> None:
        self._thread.join(60.0)
        assert not self._thread.is_alive()
