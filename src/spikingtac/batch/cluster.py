"""A Dask cluster as the worker pool: connections, and what happens when parts of it are lost.

Whoever reaches a Dask scheduler can run code on its workers, and Dask has no password: so it is
reached on this machine, or over TLS with certificates on both sides.
"""

from __future__ import annotations

import ipaddress
import math
import queue
import time
import uuid
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from spikingtac.batch.job import FileJob, Outcome, run_text, text_of
from spikingtac.errors import ConfigError, DeviceError, MissingExtraError

if TYPE_CHECKING:
    from distributed import Client, Future

TLS_FILES = ("ca.pem", "cert.pem", "key.pem")
"""Certificate of the authority, own certificate, own key."""
DEFAULT_PORT = 8786
"""Port of ``dask scheduler`` by default."""
CONNECT_S = 10.0
"""Time for one attempt to connect."""
PATIENCE_S = 60.0
"""How long a scheduler that was lost is waited for."""
LEAST_IN_FLIGHT = 64
PER_THREAD = 4
"""Jobs that are with the cluster at a time, at least and for each thread: the rest waits here."""
LOOK_S = 0.5
"""Time between two looks at the connection."""
REFILL = 4
"""Jobs are handed out together, a share of 1 / REFILL of all that may be with the cluster."""
TOGETHER_S = 0.1
"""How long results are waited for that are fetched with the first one, s. Each call costs scheduler
and client time, whatever comes with it: where all is one machine, they take it from the workers."""


def check_address(address: str, tls: Path | None) -> str:
    """Return the address of a scheduler, with its port.

    Raises:
        ConfigError: It is none, is reached without encryption from elsewhere, or TLS lacks files.
    """
    parts = urlsplit(address)
    if parts.scheme not in ("tcp", "tls") or not parts.hostname or parts.path.strip("/"):
        raise ConfigError(
            f"--scheduler {address!r} is no address; valid are tcp://127.0.0.1:8786 and "
            "tls://HOST:8786"
        )
    if parts.scheme == "tcp" and not _is_loopback(parts.hostname):
        raise ConfigError(
            f"--scheduler {address!r} would send work over the network without encryption or "
            "password; use tls:// with --tls FOLDER, or a tunnel: ssh -L 8786:127.0.0.1:8786 HOST"
        )
    if (parts.scheme == "tls") != (tls is not None):
        raise ConfigError("tls:// and --tls FOLDER (ca.pem, cert.pem, key.pem) go together")
    missing = [name for name in TLS_FILES if tls is not None and not (tls / name).is_file()]
    if missing:
        raise ConfigError(f"--tls {str(tls)!r} holds no {', '.join(missing)}")
    host = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
    try:
        return f"{parts.scheme}://{host}:{parts.port or DEFAULT_PORT}"
    except ValueError as error:
        raise ConfigError(f"--scheduler {address!r}: {error}") from error


def run_on_cluster(
    jobs: Iterable[FileJob], address: str, tls: Path | None = None, patience_s: float = PATIENCE_S
) -> Iterator[Outcome]:
    """Yield the outcome of every job, as they come.

    A job whose worker dies is given to another one by the scheduler, some times. What was with a
    scheduler that is lost is given to it again once it is back: outputs are whole and the same.

    Args:
        jobs: The jobs; their paths must mean the same on every machine.
        address: From :func:`check_address`.
        tls: Folder with the certificates.
        patience_s: How long a scheduler that was lost is waited for, s.

    Raises:
        DeviceError: There is no scheduler, it did not come back, or it had no worker for so long.
        MissingExtraError: ``distributed`` is not installed.
    """
    waiting = deque(jobs)
    client = connect(address, tls, CONNECT_S)
    flight, workers = _Flight(), _Workers(patience_s)
    try:
        while waiting or flight.jobs:
            most = workers.most_in_flight(client)
            try:
                room = most - len(flight.jobs)
                if waiting and room >= most // REFILL:
                    flight.submit(client, waiting, room)
                yield from flight.landed(client, waiting)
            except _ConnectionLostError:
                pass
            if client.status != "running":
                flight.give_back(waiting)
                client = _again(client, address, tls, patience_s)
    finally:
        flight.cancel()
        with suppress(OSError, TimeoutError):
            client.close(timeout=LOOK_S)


class _ConnectionLostError(Exception):
    """The scheduler cannot be reached."""


class _Workers:
    """The workers, looked at from time to time."""

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._worked_s, self._looked_s = time.monotonic(), -math.inf
        self._threads = 0

    def most_in_flight(self, client: Client) -> int:
        """Return how many jobs may be with the cluster.

        Raises:
            DeviceError: It has had no worker for too long.
        """
        now_s = time.monotonic()
        if now_s - self._looked_s >= LOOK_S:
            self._threads, self._looked_s = threads_of(client), now_s
            self._worked_s = now_s if self._threads else self._worked_s
        if now_s - self._worked_s > self._patience_s:
            raise DeviceError(
                f"the Dask scheduler has had no worker for {self._patience_s:.0f} s; start one "
                "with: dask worker ADDRESS --nthreads 1; what is done is kept, go on with --resume"
            )
        return max(LEAST_IN_FLIGHT, PER_THREAD * self._threads)


class _Flight:
    """The jobs that are with the cluster."""

    def __init__(self) -> None:
        self.jobs: dict[Future, FileJob] = {}
        self._done: queue.SimpleQueue[Future] = queue.SimpleQueue()
        self._run, self._given = uuid.uuid4().hex, 0

    def submit(self, client: Client, waiting: deque[FileJob], most: int) -> None:
        """Give the cluster the first jobs of those that wait, in one message."""
        jobs = list(islice(waiting, most))
        # Dask takes keys that differ in their last 32 digits for one group, of which it hands out
        # one by one; other tasks it deals out at once, and workers that come later have none.
        keys = [f"spikingtac-{self._run}-{self._given + n:032x}" for n in range(len(jobs))]
        try:
            futures = client.map(run_text, [text_of(job) for job in jobs], key=keys, pure=False)
        except (OSError, RuntimeError, ValueError) as error:  # closed between two calls
            raise _ConnectionLostError from error
        for future, job in zip(futures, jobs, strict=True):
            self.jobs[future] = job
            waiting.popleft()
            future.add_done_callback(self._done.put)
        self._given += len(jobs)

    def landed(self, client: Client, waiting: deque[FileJob]) -> Iterator[Outcome]:
        """Yield what came within a moment; jobs that the cluster lost go back to ``waiting``."""
        landed = {future: self.jobs.pop(future) for future in self._done_futures()}
        texts = _texts(client, [future for future in landed if future.status == "finished"])
        for future, job in landed.items():
            text = texts.get(future)
            outcome = Outcome.parse(text) if text else _outcome(future, job)
            if outcome is not None:
                yield outcome
            else:
                waiting.appendleft(job)

    def _done_futures(self) -> list[Future]:
        try:
            found = [self._done.get(timeout=LOOK_S)]
        except queue.Empty:
            return []
        time.sleep(TOGETHER_S)
        with suppress(queue.Empty):
            while True:
                found.append(self._done.get_nowait())
        return [future for future in found if future in self.jobs]

    def give_back(self, waiting: deque[FileJob]) -> None:
        waiting.extendleft(self.jobs.values())
        self.jobs.clear()

    def cancel(self) -> None:
        for future in self.jobs:
            with suppress(Exception):  # the cluster may be gone
                future.cancel()
        self.jobs.clear()


def _texts(client: Client, futures: list[Future]) -> dict[Future, str]:
    """Fetch what finished jobs returned, all in one call; nothing where that fails."""

    async def fetch() -> list[str]:
        texts: Any = client.gather(futures, asynchronous=True)
        return await texts

    try:
        texts: Any = client.sync(fetch, callback_timeout=CONNECT_S) if futures else []
        return dict(zip(futures, texts, strict=True))
    except Exception:  # one of them is lost: they are asked one by one
        return {}


def _outcome(future: Future, job: FileJob) -> Outcome | None:
    try:
        return Outcome.parse(future.result(timeout=CONNECT_S))
    except (CancelledError, OSError, TimeoutError):
        return None  # lost with its scheduler
    except Exception as error:  # run_text raises nothing: this is the scheduler's own
        text = f"the cluster gave it up: {type(error).__name__}: {error}"
        return Outcome.failure(job, text, type(error).__name__)


def threads_of(client: Client) -> int:
    """Return how many threads the workers have together; 1 where the scheduler cannot be asked."""
    try:
        threads: dict[str, int] = client.nthreads()  # type: ignore[assignment]
        return sum(threads.values())
    except Exception:  # it is lost, which is noticed below
        return 1


def connect(address: str, tls: Path | None, timeout_s: float) -> Client:
    """Return a client of a scheduler.

    Args:
        address: From :func:`check_address`.
        tls: Folder with the certificates.
        timeout_s: Longest wait for an answer, s.

    Raises:
        DeviceError: Nobody answers.
        MissingExtraError: ``distributed`` is not installed.
    """
    try:
        from distributed import Client, Security
    except ImportError as error:
        raise MissingExtraError(
            "a Dask cluster needs distributed; install it with: pip install 'spikingtac[cluster]'"
        ) from error
    options: dict[str, Any] = {}
    if tls is not None:
        ca, cert, key = (str(tls / name) for name in TLS_FILES)
        options["security"] = Security(
            tls_ca_file=ca, tls_client_cert=cert, tls_client_key=key, require_encryption=True
        )
    try:
        return Client(address, timeout=timeout_s, set_as_default=False, **options)
    except (OSError, TimeoutError, ValueError) as error:
        raise DeviceError(
            f"no Dask scheduler answers at {address}: {error}; start one with: "
            "dask scheduler --host 127.0.0.1"
        ) from error


def _again(client: Client, address: str, tls: Path | None, patience_s: float) -> Client:
    """Wait for a scheduler that was lost, and connect to it again."""
    with suppress(OSError, TimeoutError):
        client.close(timeout=LOOK_S)
    deadline = time.monotonic() + patience_s
    while True:
        try:
            return connect(address, tls, LOOK_S * 4)
        except DeviceError as error:
            if time.monotonic() > deadline:
                raise DeviceError(
                    f"the Dask scheduler at {address} was lost and did not come back within "
                    f"{patience_s:.0f} s; what is done is kept, go on with --resume"
                ) from error
            time.sleep(LOOK_S)


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
