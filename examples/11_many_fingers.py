"""Several fingers at once: a process for each, the latest displacement of all in one place.

Run: python examples/11_many_fingers.py
"""

import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

import spikingtac as st

FINGERS = ("thumb", "index")
SECONDS = 1.0


def record(folder: Path) -> None:
    """Write a simulated recording and its calibration."""
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


def main() -> dict[str, int]:
    """Read two fingers ten times a second until both have ended; return the frames of each."""
    with ExitStack() as opened:
        folder = Path(opened.enter_context(tempfile.TemporaryDirectory()))
        record(folder)
        hand: dict[str, st.Live] = {}
        for name in FINGERS:  # yours are cameras: st.live("udp:7777", ...)
            finger = st.live(
                folder / "demo.raw",
                calibration=folder / "calibration.json",
                preset="fast",
                rate_hz=500.0,
            )
            hand[name] = opened.enter_context(finger)
        while any(one.health.state in ("starting", "running") for one in hand.values()):
            for name, finger in hand.items():
                frame = finger.latest()
                if frame is not None:
                    farthest_px = np.linalg.norm(frame.displacement_px, axis=1).max()
                    print(f"{name}: {frame.t_us} us, {farthest_px:.1f} px")
            time.sleep(0.1)
        health = {name: finger.health for name, finger in hand.items()}
    for name, one in health.items():
        print(f"{name}: {one.state}, {one.frames} frames, {one.lost.gaps} gaps")
    return {name: one.frames for name, one in health.items()}


if __name__ == "__main__":
    main()
