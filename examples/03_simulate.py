"""Simulate a scene as a live stream with ground truth, then as a recording folder.

Run: python examples/03_simulate.py
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import spikingtac as st

SCENE, SEED, SECONDS = "finger-slides", 7, 1.5


def main() -> None:
    """Print what the markers and the events do every quarter of a second, and where files lie."""
    scene = st.load_scene(SCENE)
    source = st.SceneSource(scene, SEED, SECONDS)
    events, force_n, next_us = 0, 0.0, 250_000
    for step in source.steps():
        events += len(step.packet)
        force_n = max(force_n, float(step.truth.force_n[-1, 2]))
        if step.packet.t_end_us >= next_us:
            moved = np.linalg.norm(step.truth.marker_px[-1] - source.reference_px, axis=1)
            sys.stdout.write(
                f"{next_us / 1e6:.2f} s: {events:6d} events, largest force {force_n:.2f} N, "
                f"largest displacement now {moved.max():.2f} px\n"
            )
            events, force_n, next_us = 0, 0.0, next_us + 250_000

    with tempfile.TemporaryDirectory() as folder:
        summary = st.simulate(scene, folder, seed=SEED, duration_s=SECONDS)
        read = sum(len(packet) for packet in st.open_events(folder))
        names = ", ".join(sorted(path.name for path in Path(folder).iterdir()))
        sys.stdout.write(f"recording: {names}; {read} of {summary['events']} events read back\n")


if __name__ == "__main__":
    main()
