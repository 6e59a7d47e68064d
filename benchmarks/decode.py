"""Decode and encode rates beside the library evt3, in one run and on one thread.

Usage: ``python benchmarks/decode.py [RECORDING.raw] [--events 5000000] [--rounds 5]``. Without a
recording, synthetic events are used: clusters that move over a 1280x720 sensor. Only ratios within
one run count; a busy machine changes the figures, hardly the ratios.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from spikingtac.events import create_events, open_events
from spikingtac.types import EventPacket

ENCODINGS = ("evt2", "evt21", "evt3")
EVENTS_PER_MEV = 1_000_000


def synthetic(events: int) -> EventPacket:
    rng = np.random.default_rng(0)
    width, height = 1280, 720
    t = np.sort(rng.integers(0, events // 10, events))
    centre = np.stack((t // 3 % width, t // 7 % height))
    spread = rng.normal(0, 40, (2, events)).astype(np.int64)
    x, y = (centre + spread) % np.array([[width], [height]])
    order = np.lexsort((x, y, t))
    columns = x[order].astype(np.uint16), y[order].astype(np.uint16), rng.random(events) < 0.5
    return EventPacket(*columns, t, 0, int(t[-1]) + 1, (width, height))


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def read_all(path: Path) -> int:
    return sum(len(packet) for packet in open_events(path))


def write_all(path: Path, packets: list[EventPacket], encoding: str) -> None:
    with create_events(path, packets[0].size, encoding=encoding) as writer:
        for packet in packets:
            writer.write(packet)


def library_reader(path: Path) -> Callable[[], object] | None:
    try:
        import evt3
    except ImportError:
        return None
    return lambda: [len(batch) for batch in evt3.decode_file_batches(str(path))]


def rates_mev_s(packets: list[EventPacket], rounds: int) -> dict[str, float]:
    """Write and read the packets in every encoding; return median rates by task."""
    total = sum(len(packet) for packet in packets) / EVENTS_PER_MEV
    with tempfile.TemporaryDirectory() as folder:
        files = {name: Path(folder) / f"{name}.raw" for name in ENCODINGS}
        work: dict[str, Callable[[], object]] = {}
        for name, path in files.items():
            work[f"encode {name}"] = lambda p=path, n=name: write_all(p, packets, n)
            work[f"decode {name}"] = lambda p=path: read_all(p)
        if (library := library_reader(files["evt3"])) is not None:
            work["library evt3"] = library
        for task in work.values():  # compile, and fill the page cache
            task()
        times = {name: [] for name in work}
        for _ in range(rounds):
            for name, task in work.items():
                times[name].append(seconds(task))
    return {name: total / float(np.median(found)) for name, found in times.items()}


def print_rates(rates: dict[str, float]) -> None:
    for name, rate in rates.items():
        print(f"{name:14} {rate:8.1f} Mev/s")
    if "library evt3" in rates:
        print(f"decode evt3 / library evt3: {rates['decode evt3'] / rates['library evt3']:.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", nargs="?", type=Path)
    parser.add_argument("--events", type=int, default=5_000_000)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    packets = (
        list(open_events(options.recording)) if options.recording else [synthetic(options.events)]
    )
    print(f"{sum(map(len, packets)):,} events, median of {options.rounds} rounds")
    print_rates(rates_mev_s(packets, options.rounds))


if __name__ == "__main__":
    main()
