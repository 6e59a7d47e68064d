"""A Dask cluster in the place of worker processes: for work in which one task leads to the next."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from spikingtac._version import package_version
from spikingtac.batch.cluster import CONNECT_S, LOOK_S, PATIENCE_S, connect, threads_of
from spikingtac.batch.job import require_version
from spikingtac.errors import DeviceError

GIVEN_UP = "KilledWorker"
"""What Dask raises for a task whose workers died; known by name, for it is imported elsewhere."""
Given = ParamSpec("Given")
Result = TypeVar("Result")


@contextmanager
def cluster_pool(
    address: str, tls: Path | None = None, patience_s: float = PATIENCE_S
) -> Iterator[Executor]:
    """Give out the tasks of a run to a cluster; at the end, those that were not begun are dropped.

    A task whose worker dies is given to another one by the scheduler, some times. Functions and
    what they are given must be importable on every worker, and paths mean the same there.

    Args:
        address: From :func:`~spikingtac.batch.cluster.check_address`.
        tls: Folder with the certificates.
        patience_s: How long a cluster without workers is waited for, s.

    Yields:
        The pool to submit the tasks to.

    Raises:
        DeviceError: There is no scheduler, it was lost, or it had no worker for so long; or a task
            killed its workers.
        MissingExtraError: ``distributed`` is not installed.
    """
    client = connect(address, tls, CONNECT_S)
    pool, ended = _ClusterPool(client), threading.Event()
    watch = threading.Thread(target=pool.watch, args=(ended, patience_s), daemon=True)
    watch.start()
    try:
        yield pool
    except CancelledError as error:  # nobody here cancels: the cluster did
        raise DeviceError(
            f"the Dask scheduler at {address} was lost, or had no worker for {patience_s:.0f} s; "
            "start it and its workers (dask worker ADDRESS --nthreads 1); what is done is kept, go "
            "on with --resume"
        ) from error
    except Exception as error:
        if type(error).__name__ != GIVEN_UP:
            raise
        raise DeviceError(
            f"the cluster gave a task up, since its workers died of it ({error}); what is done is "
            "kept, go on with --resume"
        ) from error
    finally:
        ended.set()
        pool.shutdown(wait=False, cancel_futures=True)
        with suppress(OSError, TimeoutError):
            client.close(timeout=LOOK_S)
        watch.join()


class _ClusterPool(Executor):
    """Submits to a client; a cluster that cannot do the work cancels what it has."""

    def __init__(self, client: Any) -> None:
        self._client, self._inner = client, client.get_executor(pure=False)

    def submit(
        self, fn: Callable[Given, Result], /, *args: Given.args, **kwargs: Given.kwargs
    ) -> Future[Result]:
        return self._inner.submit(run_task, package_version(), fn, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        with suppress(OSError, RuntimeError, TimeoutError):  # the cluster may be gone
            self._inner.shutdown(wait=wait)

    def watch(self, ended: threading.Event, patience_s: float) -> None:
        """Cancel everything where there was no worker for so long, s, or no scheduler."""
        worked_s = time.monotonic()
        while not ended.wait(LOOK_S):
            if threads_of(self._client):
                worked_s = time.monotonic()
            if self._client.status != "running" or time.monotonic() - worked_s > patience_s:
                return self.shutdown(wait=False)


def run_task(
    version: str, function: Callable[..., Result], args: tuple[Any, ...], kwargs: dict[str, Any]
) -> Result:
    """Do a task on a worker.

    Args:
        version: The package that asks.
        function: The task.
        args: What it is given.
        kwargs: What it is given by name.

    Raises:
        ConfigError: The worker runs another version.
    """
    require_version(version)
    return function(*args, **kwargs)
