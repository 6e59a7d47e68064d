"""What every kind of crew must do with many recordings: worker processes, and a Dask cluster."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spikingtac.batch.cluster import LEAST_IN_FLIGHT, LOOK_S, TOGETHER_S, run_on_cluster
from spikingtac.batch.cluster_pool import cluster_pool, run_task
from spikingtac.batch.job import FileJob, Outcome, require_version
from spikingtac.batch.processes import ATTEMPTS, run_in_processes
from spikingtac.cli.main import main
from spikingtac.errors import ConfigError, DeviceError
from spikingtac.events import create_events, open_events
from spikingtac.types import EventPacket
from spikingtac_paper.denoise import experiment
from stand_ins.dask_cluster import DaskCluster

pytestmark = pytest.mark.waits

WORK = "spikingtac.cli.files.convert:convert_one"
SETTINGS = {
    "from_us": None,
    "to_us": None,
    "flip_polarity": False,
    "encoding": None,
    "sensor": 0,
    "strict": False,
}
EVENTS = 100

Crew = Callable[[Sequence[FileJob]], Iterator[Outcome]]


def recording(path: Path) -> Path:
    t = np.arange(EVENTS, dtype=np.int64)
    column = (t % 20).astype(np.uint16)
    with create_events(path, (32, 24)) as writer:
        writer.write(EventPacket(column, column, column < 5, t, 0, EVENTS, (32, 24)))
    return path


def job(source: Path) -> FileJob:
    output = source.with_suffix(".npz")
    name = source.stem
    return FileJob(work=WORK, source=str(source), output=str(output), settings=SETTINGS, key=name)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    pytest.importorskip("distributed", reason="the extra [cluster] is not installed")
    with DaskCluster(tmp_path_factory.mktemp("dask")) as running:
        yield running


@pytest.fixture(params=["processes", "cluster"])
def crew(request: pytest.FixtureRequest) -> Crew:
    if request.param == "processes":
        return lambda jobs: run_in_processes(jobs, 1)
    running: DaskCluster = request.getfixturevalue("cluster")
    return lambda jobs: run_on_cluster(jobs, running.address)


def test_every_job_has_its_outcome_once_and_failures_stop_nothing(
    crew: Crew, tmp_path: Path
) -> None:
    jobs = [job(recording(tmp_path / f"{n}.raw")) for n in range(3)]
    jobs.insert(1, job(tmp_path / "gone.raw"))
    outcomes = {outcome.key: outcome for outcome in crew(jobs)}
    assert sorted(outcomes) == ["0", "1", "2", "gone"]
    assert [key for key, outcome in outcomes.items() if outcome.failed] == ["gone"]
    for key in "012":
        assert outcomes[key].figures["events"] == EVENTS
        assert outcomes[key].output_bytes == (tmp_path / f"{key}.npz").stat().st_size
        assert sum(map(len, open_events(outcomes[key].output))) == EVENTS


def test_a_crew_that_is_given_up_ends(crew: Crew, tmp_path: Path) -> None:
    pipe, others = tmp_path / "pipe.raw", set(multiprocessing.active_children())
    os.mkfifo(pipe)
    outcomes = crew([job(recording(tmp_path / "a.raw")), job(pipe)])
    assert next(outcomes).key == "a"
    outcomes.close()  # type: ignore[attr-defined]
    assert set(multiprocessing.active_children()) <= others
    release(pipe)


def release(pipe: Path) -> None:
    """Let whoever waits for a writer of a pipe see its end; who comes later finds no pipe."""
    end = os.open(pipe, os.O_RDWR | os.O_NONBLOCK)
    pipe.unlink()
    os.close(end)


def opened_by_a_worker(pipe: Path) -> int:
    """Wait until a worker reads a pipe, and return the end to write to."""
    deadline = time.monotonic() + 60
    while True:
        try:
            return os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
        except OSError:
            assert time.monotonic() < deadline, "no worker opened the recording"
            time.sleep(0.02)


def kill_the_worker(others: set[BaseProcess]) -> None:
    (worker,) = set(multiprocessing.active_children()) - others
    assert worker.pid is not None
    os.kill(worker.pid, signal.SIGKILL)


def watched(pipe: Path, jobs: Sequence[FileJob], deaths: int) -> dict[str, Outcome]:
    """Run jobs on one worker, which is killed so many times while it reads the pipe."""
    import threading

    others = set(multiprocessing.active_children())  # of whatever this process ran before

    def reaper() -> None:
        for _ in range(deaths):
            end = opened_by_a_worker(pipe)
            kill_the_worker(others)
            time.sleep(0.2)
            os.close(end)

    thread = threading.Thread(target=reaper)
    thread.start()
    found = {outcome.key: outcome for outcome in run_in_processes(jobs, 1)}
    thread.join()
    return found


def test_a_recording_that_kills_its_worker_is_given_up_and_the_rest_goes_on(
    tmp_path: Path,
) -> None:
    pipe = tmp_path / "deadly.raw"
    os.mkfifo(pipe)
    jobs = [job(pipe), *(job(recording(tmp_path / f"{n}.raw")) for n in range(2))]
    outcomes = watched(pipe, jobs, ATTEMPTS)
    assert sorted(outcomes) == ["0", "1", "deadly"]
    assert outcomes["deadly"].kind == "WorkerLost"
    assert not outcomes["0"].failed
    assert not outcomes["1"].failed


def test_a_cluster_without_workers_is_told(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the extra [cluster] is not installed")
    jobs = [job(recording(tmp_path / "a.raw"))]
    with DaskCluster(tmp_path, workers=0) as empty:
        with pytest.raises(DeviceError, match="no worker"):
            list(run_on_cluster(jobs, empty.address, patience_s=0.2))
        with (
            pytest.raises(DeviceError, match="no worker"),
            cluster_pool(empty.address, patience_s=0.2) as pool,
        ):
            pool.submit(abs, -1).result()


def test_a_cluster_is_not_asked_for_every_job(
    cluster: DaskCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each question took scheduler and client time that workers on the same cores lacked."""
    from distributed import Client

    asked: Counter[str] = Counter()

    def counted(name: str) -> Callable[..., Any]:
        inner = getattr(Client, name)

        def call(self: Client, *args: Any, **kwargs: Any) -> Any:
            asked[name] += 1
            return inner(self, *args, **kwargs)

        return call

    for name in ("map", "submit", "gather", "nthreads"):
        monkeypatch.setattr(Client, name, counted(name))
    source = recording(tmp_path / "a.raw")
    jobs = [
        replace(job(source), key=str(n), output=str(tmp_path / f"{n}.npz"))
        for n in range(LEAST_IN_FLIGHT + 40)
    ]
    begun_s = time.monotonic()
    found = [outcome.key for outcome in run_on_cluster(jobs, cluster.address)]
    taken_s = time.monotonic() - begun_s
    assert sorted(found) == sorted(one.key for one in jobs)
    assert asked["submit"] == 0
    assert asked["map"] <= 4
    assert asked["gather"] <= taken_s / TOGETHER_S
    assert asked["nthreads"] <= taken_s / LOOK_S + 1


def test_results_that_cannot_be_fetched_together_are_fetched_one_by_one(
    cluster: DaskCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from distributed import Client

    def lost(self: Client, *args: Any, **kwargs: Any) -> Any:
        raise TimeoutError("one of the workers is gone")

    monkeypatch.setattr(Client, "gather", lost)
    jobs = [job(recording(tmp_path / f"{n}.raw")) for n in range(3)]
    outcomes = list(run_on_cluster(jobs, cluster.address))
    assert sorted(outcome.key for outcome in outcomes if not outcome.failed) == ["0", "1", "2"]


def test_a_pool_on_a_cluster_gives_results_in_order_and_errors(cluster: DaskCluster) -> None:
    with cluster_pool(cluster.address) as pool:
        assert list(pool.map(divmod, (7, 9), (2, 4))) == [(3, 1), (2, 1)]
        with pytest.raises(ConfigError, match="install the same version"):
            pool.submit(require_version, "0.0").result()


def test_work_of_another_version_is_refused() -> None:
    with pytest.raises(ConfigError, match="install the same version"):
        run_task("0.0", abs, (-1,), {})


def test_an_experiment_gives_the_same_on_a_cluster_as_in_one_process(
    cluster: DaskCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Computing times apart. The cluster's workers run in another folder."""
    short = {"scenes": ("finger-torsion",), "noise_hz": (1.0,), "drop": (0.5,), "duration_s": 0.4}
    every = {"every_us": 100_000, "first_us": 200_000}
    monkeypatch.setattr(experiment, "QUICK", short | every)
    monkeypatch.setattr(experiment, "before_and_after", lambda config: ("", "<svg></svg>"))
    monkeypatch.delenv("SPIKINGTAC_DATA", raising=False)
    monkeypatch.chdir(tmp_path)
    rows = []
    for folder, crew in (("one", ("--workers", "1")), ("all", ("--scheduler", cluster.address))):
        assert main(["experiment", "denoise", "--quick", "-o", folder, *crew, "--json"]) == 0
        report = json.loads((tmp_path / folder / "report.json").read_text(encoding="utf-8"))
        rows.append([row for row in report["rows"] if row["metric"] != "step_p50_us"])
    assert rows[0] == rows[1]
    assert len(rows[0]) > 20
