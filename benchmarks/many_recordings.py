"""Two hundred recordings, and what may happen meanwhile: killed workers, a lost scheduler, Ctrl-C.

    python benchmarks/many_recordings.py -o results/many-recordings [--recordings 200] [--turns 3]

Recordings of the twin (scene finger-torsion, one window each of one rendering) are tracked by the
preset ``default``: by a loop in one process, by a Dask cluster of one and of two workers on this
machine, by one and two worker processes, in turns (one, two, one, two), of which medians are told;
then by a cluster that loses a worker (SIGKILL) and its
scheduler (SIGKILL, started again with new workers) and whose client is interrupted (SIGINT) and
resumed, and by worker processes with the same faults. The exit code is 1 unless every run holds
every result once, equal byte for byte to that of the loop. Needs the extra [cluster].
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from spikingtac.calibration.sensor_calibration import Calibration  # noqa: E402
from spikingtac.cli.sensing.track import Args, _settings, track_one  # noqa: E402
from spikingtac.events import create_events  # noqa: E402
from spikingtac.sim.scene.catalog import load  # noqa: E402
from spikingtac.sim.scene.source import SceneSource  # noqa: E402
from spikingtac.types import EventPacket  # noqa: E402
from stand_ins.dask_cluster import DaskCluster  # noqa: E402

SCENE, SEED = "finger-torsion", 1
WINDOW_US = 200_000
STEP_US = 20_000


def make_recordings(folder: Path, count: int) -> None:
    """Write windows of one rendering of the twin, and the sensor's calibration."""
    scene = load(SCENE)
    source = SceneSource(scene, seed=SEED)
    Calibration(
        reference_px=np.asarray(source.reference_px),
        radius_px=np.asarray(source.radius_px),
        grid=scene.skin.grid,
        size=scene.size,
    ).save(folder / "calibration.json")
    whole = EventPacket.concatenate([step.packet for step in source.steps()])
    room = (whole.t_end_us - whole.t_start_us - WINDOW_US) // STEP_US
    (folder / "recordings").mkdir()
    for number in range(count):
        first_us = whole.t_start_us + (number % room) * STEP_US
        length_us = WINDOW_US - 1_000 * (number // room)  # no two of them are equal
        inside = (whole.t >= first_us) & (whole.t < first_us + length_us)
        with create_events(folder / "recordings" / f"{number:03}.raw", scene.size) as writer:
            writer.write(whole.select(inside))


def loop(folder: Path) -> tuple[float, dict[str, str]]:
    """Track one by one in this process; return the seconds, without compilation, and digests."""
    output = folder / "loop"
    output.mkdir()
    given = Args(recordings=(), calibration=folder / "calibration.json")
    recordings = sorted((folder / "recordings").iterdir())
    track_one(_settings(given), recordings[0], output / "warm.npz")
    (output / "warm.npz").unlink()
    begun = time.perf_counter()
    for recording in recordings:
        track_one(_settings(given), recording, output / f"{recording.stem}.npz")
    return time.perf_counter() - begun, digests(output)


def digests(folder: Path) -> dict[str, str]:
    """Return the sha256 of every result."""
    files = sorted(folder.glob("*.npz"))
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def client(folder: Path, output: str, *options: str) -> subprocess.Popen[bytes]:
    """Start the command line on all recordings."""
    given = ("--calibration", folder / "calibration.json", "-o", folder / output, *options)
    command = [sys.executable, "-m", "spikingtac", "track", folder / "recordings", *given]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)


def finished(process: subprocess.Popen[bytes]) -> dict[str, object]:
    """Return what a client printed with --json."""
    text = process.communicate()[0]
    assert process.returncode == 0, f"exit code {process.returncode}: {text.decode()}"
    return json.loads(text)


def wait_for(folder: Path, output: str, lines: int) -> None:
    """Wait until so many recordings are done."""
    journal = folder / output / "journal.jsonl"
    while not journal.is_file() or journal.read_bytes().count(b"\n") < lines:
        time.sleep(0.02)


def timed(folder: Path, output: str, workers: int, *options: str) -> dict[str, float]:
    """Return the time of a run without its first results, and what it took beside the work itself.

    ``seconds`` is scaled to all recordings; the start of the workers is no part of it.
    ``overhead_ms`` is the time of the workers, for each recording, in which none was worked on.
    """
    process = client(folder, output, "--json", *options)
    wait_for(folder, output, WARM)
    begun = time.perf_counter()
    wait_for(folder, output, len(list((folder / "recordings").iterdir())))
    taken_s = time.perf_counter() - begun
    finished(process)
    lines = (folder / output / "journal.jsonl").read_text().splitlines()
    worked_s = sum(json.loads(line)["seconds"] for line in lines[WARM:])
    rest = len(lines) - WARM
    return {
        "seconds": round(taken_s * len(lines) / rest, 2),
        "overhead_ms": round(1e3 * (workers * taken_s - worked_s) / rest, 1),
    }


WARM = 10
"""Results that are not timed, while the workers load their kernels."""


def faults_on_cluster(folder: Path, count: int) -> dict[str, object]:
    """Kill a worker, restart the scheduler, interrupt the client; return what the last one said."""
    with DaskCluster(folder, workers=2) as cluster:
        process = client(folder, "cluster-faults", "--scheduler", cluster.address)
        wait_for(folder, "cluster-faults", count // 5)
        cluster.workers[0].kill()
        cluster.workers.append(cluster.start_worker())
        wait_for(folder, "cluster-faults", 2 * count // 5)
        cluster.scheduler.kill()
        cluster.scheduler.wait()
        cluster.start_scheduler()
        cluster.workers += [cluster.start_worker() for _ in range(2)]
        wait_for(folder, "cluster-faults", 3 * count // 5)
        process.send_signal(signal.SIGINT)
        process.communicate()
        assert process.returncode == 130, process.returncode
        options = ("--scheduler", cluster.address, "--resume", "--json")
        return finished(client(folder, "cluster-faults", *options))


def faults_in_processes(folder: Path, count: int) -> dict[str, object]:
    """Kill worker processes and interrupt their parent; return what the last one said."""
    process = client(folder, "process-faults", "--workers", "2")
    for share in (1, 2):
        wait_for(folder, "process-faults", share * count // 5)
        os.kill(children_of(process.pid)[-1], signal.SIGKILL)
    wait_for(folder, "process-faults", 3 * count // 5)
    process.send_signal(signal.SIGINT)
    process.communicate()
    assert process.returncode == 130, process.returncode
    return finished(client(folder, "process-faults", "--workers", "2", "--resume", "--json"))


def children_of(process: int) -> list[int]:
    """Return the worker processes of a process."""
    found = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    return [int(child) for child in found if "spawn_main" in _command(child)]


def _command(process: str) -> str:
    return Path(f"/proc/{process}/cmdline").read_text()


def on_cluster(folder: Path, output: str, workers: int) -> dict[str, float]:
    """Time a cluster of so many workers, started and set as the how-to tells."""
    with DaskCluster(folder, workers=workers, nannies=True) as cluster:
        return timed(folder, output, workers, "--scheduler", cluster.address)


def in_processes(folder: Path, output: str, workers: int) -> dict[str, float]:
    """Time so many worker processes."""
    return timed(folder, output, workers, "--workers", str(workers))


Run = Callable[[Path, str, int], dict[str, float]]


def in_turns(folder: Path, name: str, run: Run, turns: int) -> dict[str, object]:
    """Time one and two workers, one after the other, some times; return the medians."""
    found: dict[int, list[dict[str, float]]] = {1: [], 2: []}
    for turn in range(turns):
        for workers, timings in found.items():
            timings.append(run(folder, f"{name}-{workers}-{turn + 1}", workers))
    one, two = (
        {key: round(median(timing[key] for timing in timings), 2) for key in timings[0]}
        | {"every_s": [timing["seconds"] for timing in timings]}
        for timings in found.values()
    )
    speedup = round(one["seconds"] / two["seconds"], 3)  # type: ignore[operator]
    return {"one_worker": one, "two_workers": two, "speedup": speedup}


def measure(folder: Path, count: int, turns: int) -> dict[str, object]:
    """Make all runs and return the figures."""
    make_recordings(folder, count)
    alone_s, expected = loop(folder)
    figures: dict[str, object] = {"recordings": count, "loop_s": round(alone_s, 2)}
    for name, run in (("cluster", on_cluster), ("processes", in_processes)):
        figures[name] = in_turns(folder, name, run, turns)
    for name, fault in (
        ("cluster-faults", faults_on_cluster),
        ("process-faults", faults_in_processes),
    ):
        said = fault(folder, count)
        figures[name] = {key: said[key] for key in ("recordings", "done", "failed", "kept")}
    runs = [path.name for path in folder.iterdir() if (path / "run.json").is_file()]
    figures["equal_to_loop"] = {name: digests(folder / name) == expected for name in sorted(runs)}
    return figures


def main() -> int:
    """Measure, write, and say whether everything is there."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--turns", type=int, default=3)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        before = os.getloadavg()[0]
        figures = measure(Path(name), given.recordings, given.turns)
    figures["source"] = "simulated"
    figures["cpus"], figures["machine"] = os.cpu_count(), platform.machine()
    figures["load_before"], figures["load_after"] = round(before, 2), round(os.getloadavg()[0], 2)
    given.output.mkdir(parents=True, exist_ok=True)
    text = json.dumps(figures, indent=1)
    (given.output / "figures.json").write_text(text + "\n", encoding="utf-8")
    print(text)
    return 0 if all(figures["equal_to_loop"].values()) else 1  # type: ignore[attr-defined]


if __name__ == "__main__":
    sys.exit(main())
