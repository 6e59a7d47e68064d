"""What a verb compiles at its first start: every kernel with its CPU time, in every process.

    python benchmarks/kernels.py [--longest 30] demo --headless --seconds 1 --port 0
    python benchmarks/kernels.py track mix.raw --calibration calibration.json -o tracks.npz

The verb runs twice with a cache of kernels that is empty at first: the first run tells what is
compiled, the second what loading costs. A kernel's time is its thread's CPU time without that of
the kernels it calls, so that a busy machine changes little. Numba compiles functions of its own
too (``np.empty``, ``max`` and the like); they are summed up.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

LOG = "SPIKINGTAC_KERNEL_LOG"
OWN = "spikingtac."
HOOK = """
import importlib.machinery, json, os, sys, time

def note(kind, name, signature, seconds):
    with open(os.environ["SPIKINGTAC_KERNEL_LOG"], "a") as log:
        log.write(json.dumps([os.getpid(), kind, name, signature, seconds]) + "\\n")

def watch():
    from numba.core import caching, event
    class Compilations(event.Listener):
        def __init__(self):
            self.begun = []
        def on_start(self, _):
            self.begun.append([time.thread_time(), 0.0])
        def on_end(self, ended):
            begun_s, callees_s = self.begun.pop()
            took_s = time.thread_time() - begun_s
            if self.begun:
                self.begun[-1][1] += took_s
            kernel = ended.data["dispatcher"].py_func
            name = f"{kernel.__module__}.{kernel.__qualname__}"
            note("compiled", name, str(ended.data["args"]), took_s - callees_s)
    event.register("numba:compile", Compilations())
    original = caching.Cache.load_overload
    def load(self, signature, context):
        begun_s = time.thread_time()
        found = original(self, signature, context)
        if found is not None:
            note("loaded", self._py_func.__qualname__, "", time.thread_time() - begun_s)
        return found
    caching.Cache.load_overload = load

class AfterNumba:
    def find_spec(self, name, path, target=None):
        if name != "numba.core.dispatcher":
            return None
        sys.meta_path.remove(self)
        spec = importlib.machinery.PathFinder.find_spec(name, path)
        execute = spec.loader.exec_module
        spec.loader.exec_module = lambda module: (execute(module), watch())
        return spec

sys.meta_path.insert(0, AfterNumba())
"""
"""Runs at the start of every Python process, and waits until Numba is imported."""


def main() -> int:
    """Run the verb cold and warm and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--longest", type=int, default=30, help="kernels to list")
    parser.add_argument("verb", nargs=argparse.REMAINDER, help="verb and its options")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for name in ("cold", "warm"):
            rows, cpu_s = run(args.verb, Path(folder), name)
            report(name, rows, cpu_s, args.longest)
    return 0


def run(verb: list[str], folder: Path, name: str) -> tuple[list[list], float]:
    """Run a verb once; return what was noted, and the CPU seconds of all its processes."""
    (folder / "sitecustomize.py").write_text(HOOK)
    log = folder / f"{name}.log"
    log.touch()
    before_s = _children_s()
    paths = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {LOG: str(log), "PYTHONPATH": paths}
    environment["NUMBA_CACHE_DIR"] = str(folder / "cache")
    command = [sys.executable, "-m", "spikingtac", *verb]
    subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
    return [json.loads(line) for line in log.read_text().splitlines()], _children_s() - before_s


def report(name: str, rows: list[list], cpu_s: float, longest: int) -> None:
    """Print the sums of each process, what came twice, and the longest kernels."""
    print(f"\n{name}: {cpu_s:.1f} s of CPU in all processes")
    for number, pid in enumerate(dict.fromkeys(row[0] for row in rows)):
        own = [row for row in rows if row[0] == pid]
        for kind in ("compiled", "loaded"):
            ours = [row[4] for row in own if row[1] == kind and row[2].startswith((OWN, "_"))]
            every = [row[4] for row in own if row[1] == kind]
            print(
                f"  process {number}: {kind} {len(every):3} in {sum(every):5.2f} s"
                + (f", {len(ours)} of them ours" if kind == "compiled" else "")
            )
    compiled = [row for row in rows if row[1] == "compiled"]
    often = Counter(row[2] for row in compiled if row[2].startswith(OWN))
    repeated = {kernel: count for kernel, count in often.items() if count > 1}
    if repeated:
        print("  compiled more than once, by several processes or for several types:")
    for kernel, count in sorted(repeated.items()):
        print(f"    {count} {kernel}")
    for _, _, kernel, _, took_s in sorted(compiled, key=lambda row: -row[4])[:longest]:
        print(f"    {took_s:6.3f} s {kernel}")


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    sys.exit(main())
