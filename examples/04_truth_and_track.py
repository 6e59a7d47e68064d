"""Simulate slides and a contact, calibrate, track, and draw one marker beside its truth.

Run: python examples/04_truth_and_track.py [truth_and_track.png]
"""

import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import spikingtac as st

SCENE, SEED, RATE_HZ = "spoon-circles", 3, 1_000.0
SLIDES_S = 5.4  # Four of the eight slides are enough for a calibration.


def main(picture: str) -> None:
    """Draw the marker that moves farthest: truth, track, and the difference."""
    with tempfile.TemporaryDirectory() as folder:
        slides, contact = Path(folder) / "slides", Path(folder) / "contact"
        st.simulate(st.load_scene("bootstrap"), slides, seed=SEED, duration_s=SLIDES_S)
        st.simulate(st.load_scene(SCENE), contact, seed=SEED)
        calibration = st.calibrate(st.open_events(slides))
        tracker = st.make_tracker(st.load_config("default").tracking, calibration)
        frames = list(st.follow(st.open_events(contact), tracker, RATE_HZ))
        truth = st.Recording.open(contact).truth() or {}

    t_us = np.array([frame.t_us for frame in frames])
    found_px = np.array([frame.displacement_px for frame in frames])
    moved_px = truth["marker_px"] - truth["reference_px"]
    marker = int(np.linalg.norm(moved_px, axis=2).max(axis=0).argmax())

    figure, (upper, lower) = plt.subplots(2, 1, figsize=(9, 4.6), sharex=True, height_ratios=(3, 2))
    for axis, name, color in ((0, "x", "#1f6f8b"), (1, "y", "#c06c2b")):
        true_px = np.interp(t_us, truth["marker_t_us"], moved_px[:, marker, axis])
        upper.plot(t_us / 1e6, true_px, color=color, lw=4, alpha=0.3, label=f"{name}, truth")
        upper.plot(t_us / 1e6, found_px[:, marker, axis], color=color, lw=1, label=f"{name}, track")
        lower.plot(t_us / 1e6, found_px[:, marker, axis] - true_px, color=color, lw=0.8)
    upper.set_ylabel("displacement, px")
    upper.set_title(f"Marker {marker} in the scene {SCENE} (simulated)", loc="left")
    upper.legend(ncols=4, loc="upper right", fontsize="small")
    lower.set_ylabel("track - truth, px")
    lower.set_xlabel("time, s")
    lower.set_ylim(-1.0, 1.0)
    lower.axhline(0.0, color="0.7", lw=0.8, zorder=0)
    figure.tight_layout()
    figure.savefig(picture, dpi=110)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "truth_and_track.png")
