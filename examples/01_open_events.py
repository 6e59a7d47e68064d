"""Open an event file, walk through it in windows of 1 ms, and say what was wrong with it.

Run: python examples/01_open_events.py [FILE]

Without a file, a small one is written first.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import spikingtac as st

SIZE = (320, 320)


def a_moving_edge() -> st.EventPacket:
    """Return 0.1 s of an edge that crosses the sensor at 1 px/ms, 20 events in each column."""
    t = np.arange(2_000, dtype=np.int64) * 50
    x = (t // 1_000).astype(np.uint16)
    y = (np.arange(2_000) % 20 + 150).astype(np.uint16)
    return st.EventPacket(x, y, np.ones(2_000, np.bool_), t, 0, 100_000, SIZE)


def main(path: Path) -> None:
    """Print the events of each window, and the anomalies of the file."""
    source = st.open_events(path)
    print(f"{source.format}, {source.size[0]}x{source.size[1]} px", *source.notes, sep="; ")
    for window in st.windows(source, period_us=1_000):
        if len(window):
            middle = float(window.x.mean()), float(window.y.mean())
            print(f"{window.t_start_us:8} us  {len(window):6} events about {middle}")
    print("anomalies:", dict(source.losses) or "none")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as folder:
            with st.create_events(Path(folder) / "edge.raw", SIZE) as writer:
                writer.write(a_moving_edge())
            main(Path(folder) / "edge.raw")
