"""Several fingers at once: a process for each, the latest displacement of all in one place.

Run: python examples/11_many_fingers.py
"""

import tempfile
import time
from pathlib import Path

import numpy as np

import spikingtac as st

FINGERS = ("thumb", "index")
SECONDS = 1.0


def recorded(folder: Path) -> st.Finger:
    """Return a finger that plays a simulated recording; yours is a camera: source="udp:7777"."""
    source = st.SceneSource(st.load_scene("demo"), seed=1, duration_s=SECONDS)
    calibration = st.Calibration(
        reference_px=source.reference_px,
        radius_px=source.radius_px,
        grid=(8, 8),
        size=source.size,
    )
    calibration.save(folder / "calibration.json")
    with st.create_events(folder / "demo.raw", source.size) as writer:
        for packet in source:
            writer.write(packet)
    tracking = st.load_config("fast").with_tracking(rate_hz=500.0).tracking
    return st.Finger(
        source=folder / "demo.raw", calibration=folder / "calibration.json", tracking=tracking
    )


def main() -> dict[str, int]:
    """Read two fingers ten times a second until both have ended; return the frames of each."""
    with tempfile.TemporaryDirectory() as name:
        finger = recorded(Path(name))
        with st.Hand(dict.fromkeys(FINGERS, finger)) as hand:
            while any(one.state in ("starting", "running") for one in hand.health().values()):
                for name, reading in hand.latest().items():
                    if reading is not None:
                        farthest_px = np.linalg.norm(reading.displacement_px, axis=1).max()
                        print(f"{name}: {reading.t_us} us, {farthest_px:.1f} px")
                time.sleep(0.1)
            health = hand.health()
    for name, one in health.items():
        print(f"{name}: {one.state}, {one.frames} frames, {one.lost.gaps} gaps")
    return {name: one.frames for name, one in health.items()}


if __name__ == "__main__":
    main()
