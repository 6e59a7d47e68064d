"""Attack every reader with mutated files; limits per input, a JSON summary.

    python benchmarks/attack.py -o attack.json [--raw 10000] [--containers 1000] [--kinds evt3,npz]

One process at a time reads; one that dies, hangs or grows is told from its number and replaced. The
exit code is 1 where anything broke: a crash, an error that is not the package's, a promise of a
source, more than 30 s, or more than 512 MB above the idle process. The same seed gives the same
mutants, so that a failure's number is its reproduction (``--worker KIND FIRST LAST``). The summary
is written after every 500 mutants; the same command goes on where the last one ended.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import select
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from spikingtac.atomic_files import write_json  # noqa: E402
from stand_ins.hostile_files import (  # noqa: E402
    CONTAINERS,
    FILE_NAMES,
    KINDS,
    RAW_KINDS,
    mutated,
    seed_file,
)
from stand_ins.reading import outcome  # noqa: E402

TIME_LIMIT_S = 30.0
MEMORY_LIMIT_MB = 512
GRACE_S = 10.0
"""A process that does not heed its own alarm is killed so much later."""

WARM_UP = 12
"""Mutants that are read before anything is measured: they compile what damage needs."""
WARM_UP_LIMIT_S = 600.0

BATCH = 500
"""Mutants after which a process is replaced, so that its peak memory is told for few of them."""


def main() -> int:
    """Attack the kinds asked for and write the summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("attack.json"))
    parser.add_argument("--raw", type=int, default=10_000, help="mutants per RAW encoding")
    parser.add_argument("--containers", type=int, default=1_000, help="mutants per container")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--worker", nargs=3, metavar=("KIND", "FIRST", "LAST"))
    args = parser.parse_args()
    if args.worker:
        return work(args.worker[0], int(args.worker[1]), int(args.worker[2]))
    kinds = args.kinds.split(",")
    report: dict[str, Any] = {
        "limits": {"seconds": TIME_LIMIT_S, "memory_mb": MEMORY_LIMIT_MB},
        "kinds": {},
    }
    if args.output.is_file():
        report = json.loads(args.output.read_text(encoding="utf-8"))
    for kind in [kind for kind in kinds if kind in (*RAW_KINDS, *CONTAINERS)]:
        count = args.raw if kind in RAW_KINDS else args.containers
        for found in attack(kind, count, report["kinds"].get(kind)):
            report["kinds"][kind] = found
            write_json(args.output, report)
        print(kind, {k: v for k, v in report["kinds"][kind].items() if k != "failures"}, flush=True)
    failures = sum(len(found["failures"]) for found in report["kinds"].values())
    print(f"{failures} failures; {args.output}")
    return int(failures > 0)


def attack(kind: str, count: int, known: dict[str, Any] | None) -> Iterator[dict[str, Any]]:
    """Read ``count`` mutants of a kind, after those that are known; yield what became of them."""
    found: dict[str, Any] = known or {
        "mutants": 0, "read": 0, "refused": 0, "slowest_s": 0.0, "peak_mb": 0.0, "failures": [],
    }  # fmt: skip
    while found["mutants"] < count:
        first = found["mutants"]
        found["mutants"] = _batch(kind, first, min(first + BATCH, count), found)
        yield found


def _batch(kind: str, first: int, last: int, found: dict[str, Any]) -> int:
    """Let one process read mutants; return the number of the next one to read."""
    command = [sys.executable, __file__, "--worker", kind, str(first), str(last)]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    reached = first
    with child.stdout as lines:
        select.select([lines], [], [], WARM_UP_LIMIT_S)
        lines.readline()  # kernels are compiled
        begun = time.monotonic()
        while True:
            ready, _, _ = select.select([lines], [], [], TIME_LIMIT_S + GRACE_S)
            line = lines.readline() if ready else ""
            if not line:
                break
            record = json.loads(line)
            reached, begun = record["mutant"] + 1, time.monotonic()
            _count(record, found)
    if child.poll() is None and time.monotonic() - begun >= TIME_LIMIT_S:
        child.kill()
    code = child.wait()
    if reached < last:
        _count({"mutant": reached, "outcome": f"process ended with {code}"}, found)
        reached += 1
    return reached


def _count(record: dict[str, Any], found: dict[str, Any]) -> None:
    found["slowest_s"] = max(found["slowest_s"], record.get("seconds", 0.0))
    found["peak_mb"] = max(found["peak_mb"], record.get("grown_mb", 0.0))
    if record["outcome"] in ("read", "refused"):
        found[record["outcome"]] += 1
    if record["outcome"] not in ("read", "refused") or record.get("grown_mb", 0) > MEMORY_LIMIT_MB:
        found["failures"].append(record)


def work(kind: str, first: int, last: int) -> int:
    """Read mutants and tell about each on a line of its own."""
    signal.signal(signal.SIGALRM, _late)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sound = seed_file(kind, folder)
        outcome(sound)  # kernels are compiled before anything is measured
        data = sound.read_bytes()
        path = folder / "m" / FILE_NAMES[kind]
        path.parent.mkdir()
        for mutant in range(WARM_UP):  # those of salvage, too
            path.write_bytes(mutated(data, np.random.default_rng(mutant)))
            _outcome(path)
        print("{}", flush=True)
        idle_mb = _peak_mb()
        for mutant in range(first, last):
            path.write_bytes(mutated(data, np.random.default_rng(mutant)))
            begun = time.monotonic()
            record: dict[str, Any] = {"mutant": mutant, "outcome": _outcome(path)}
            record |= {"seconds": time.monotonic() - begun, "grown_mb": _peak_mb() - idle_mb}
            print(json.dumps(record), flush=True)
    return 0


def _outcome(path: Path) -> str:
    signal.setitimer(signal.ITIMER_REAL, TIME_LIMIT_S)
    try:
        return outcome(path)
    except Exception:
        return traceback.format_exc(limit=-3)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _late(number: int, frame: Any) -> None:
    raise TimeoutError(f"more than {TIME_LIMIT_S:g} s (process {os.getpid()})")


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    sys.exit(main())
