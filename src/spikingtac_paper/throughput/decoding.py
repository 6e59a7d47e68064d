"""How fast raw words become events, and events become counts and a map."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spikingtac.events import create_events, open_events
from spikingtac.state_map import BinaryStateMap
from spikingtac.types import EventPacket
from spikingtac_paper.harness.report import Metric, Row

ENCODINGS = ("evt2", "evt21", "evt3")

# Runs of each measurement; the fastest counts, since other load only makes a run slower.
REPEATS = 5

WINDOW_US = 1_000
PACKET_US = 10_000  # Length of the packets of the count and map measurement.


def decoder_rows(events: EventPacket, folder: Path) -> Iterator[Row]:
    """Yield the rows of the method ``decoder``.

    Args:
        events: The stream.
        folder: Where to write it in each encoding.
    """

    def row(name: str, unit: str, definition: str, value: float) -> Row:
        metric = Metric(name, unit, f"{definition}; fastest of {REPEATS} runs")
        return metric.row("decoder", "all", value, REPEATS)

    millions = len(events) / 1e6
    taken_s = {}
    for encoding in ENCODINGS:
        path = folder / "streams" / f"{encoding}.raw"
        path.parent.mkdir(exist_ok=True)
        with create_events(path, events.size, encoding=encoding) as writer:
            writer.write(events)
        taken_s[encoding] = fastest_s(lambda path=path: [len(part) for part in open_events(path)])
        about = f"{encoding.upper()} file on disk to checked event packets"
        yield row(f"decode_{encoding}_mev_s", "Mev/s", about, millions / taken_s[encoding])
    library_s = _library_s(folder / "streams" / "evt3.raw")
    if library_s is not None:
        about = "decode_evt3_mev_s over that of the evt3 package, the same file"
        yield row("decode_vs_evt3_library", "times", about, library_s / taken_s["evt3"])
    about = "events to 1 ms counts and the map, bounds checked"
    yield row("counts_and_map_mev_s", "Mev/s", about, millions / _count_s(events))


def fastest_s(action: Callable[[], object]) -> float:
    """Return the least time of several runs after one that is not counted, s."""
    action()
    taken = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        action()
        taken.append(time.perf_counter() - start)
    return min(taken)


def _count_s(events: EventPacket) -> float:
    edges = np.arange(events.t_start_us, events.t_end_us + PACKET_US, PACKET_US)
    at = np.searchsorted(events.t, edges)
    packets = [
        events.part(int(at[k]), int(at[k + 1]), int(edges[k]), int(edges[k + 1]))
        for k in range(len(edges) - 1)
    ]
    state_map = BinaryStateMap(events.size)

    def count() -> list[NDArray[np.int64]]:
        counts = []
        for one in packets:
            state_map.absorb(one)
            windows_us = np.arange(one.t_start_us, one.t_end_us + WINDOW_US, WINDOW_US)
            counts.append(np.diff(np.searchsorted(one.t, windows_us)))
        return counts

    return fastest_s(count)


def _library_s(path: Path) -> float | None:
    try:
        import evt3
    except ImportError:
        return None
    return fastest_s(lambda: evt3.decode_file(str(path)))
