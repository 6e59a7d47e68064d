"""A Dask scheduler and workers as processes of their own on this machine, to be killed in tests."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import Self

SETTINGS = {
    "OPENBLAS_NUM_THREADS": "1",
    "MALLOC_TRIM_THRESHOLD_": "67108864",
    "MALLOC_MMAP_THRESHOLD_": "33554432",
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "500ms",
}
"""What docs/how-to/work-on-many-recordings.md tells to set for scheduler and workers, and why. A
nanny sets the first; without one, every worker had a second thread that waited for work and kept
a core busy."""


class DaskCluster:
    """A scheduler on a port of its own, and workers with one thread each.

    Args:
        folder: For what they log and store.
        workers: Number of workers.
        tls: Folder with ca.pem, cert.pem and key.pem, to be reached with certificates only.
        nannies: Workers are started again when they die, as ``dask worker`` does unless told
            otherwise; without, a worker that is killed stays dead.
    """

    def __init__(
        self, folder: Path, workers: int = 1, tls: Path | None = None, nannies: bool = False
    ) -> None:
        self._folder = folder
        self._nanny = "--nanny" if nannies else "--no-nanny"
        self._tls = [] if tls is None else ["--tls-ca-file", str(tls / "ca.pem")]
        if tls is not None:
            self._tls += ["--tls-cert", str(tls / "cert.pem"), "--tls-key", str(tls / "key.pem")]
        with socket.create_server(("127.0.0.1", 0)) as server:
            self._port = server.getsockname()[1]
        self.address = f"{'tls' if tls else 'tcp'}://127.0.0.1:{self._port}"
        self.start_scheduler()
        self.workers = [self.start_worker() for _ in range(workers)]

    def start_scheduler(self) -> None:
        options = ("--host", "127.0.0.1", "--port", str(self._port), "--no-dashboard")
        if self._tls:
            options = ("--protocol", "tls", *options)
        self.scheduler = self._start("dask_scheduler", *options, "--dashboard-address", ":0")

    def start_worker(self) -> subprocess.Popen[bytes]:
        options = ("--host", "127.0.0.1", "--nthreads", "1", self._nanny, "--no-dashboard")
        return self._start("dask_worker", self.address, *options)

    def _start(self, module: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.{module}", *options, *self._tls]
        with (self._folder / "dask.log").open("ab") as log:
            environment = {**os.environ, **SETTINGS}
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
