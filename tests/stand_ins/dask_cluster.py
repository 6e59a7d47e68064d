"""A Dask scheduler and workers as processes of their own on this machine, to be killed in tests."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import Self


class DaskCluster:
    """A scheduler on a port of its own, and workers with one thread each.

    Args:
        folder: For what they log and store.
        workers: Number of workers.
    """

    def __init__(self, folder: Path, workers: int = 1) -> None:
        self._folder = folder
        with socket.create_server(("127.0.0.1", 0)) as server:
            port = server.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{port}"
        options = ("--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
        self.scheduler = self._start("dask_scheduler", *options, "--dashboard-address", ":0")
        self.workers = [self._start_worker() for _ in range(workers)]

    def wait_for_worker(self) -> None:
        """Wait until a worker has come."""
        from distributed import Client

        with Client(self.address, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(1, timeout=60)

    def _start_worker(self) -> subprocess.Popen[bytes]:
        options = ("--host", "127.0.0.1", "--nthreads", "1", "--no-nanny", "--no-dashboard")
        return self._start("dask_worker", self.address, *options)

    def _start(self, module: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.{module}", *options]
        with (self._folder / "dask.log").open("ab") as log:
            environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
            environment["DASK_TEMPORARY_DIRECTORY"] = str(self._folder)
            return subprocess.Popen(command, stdout=log, stderr=log, env=environment)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()
