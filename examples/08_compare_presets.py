"""Compare presets on one recording, against the truth that only a simulation knows.

Run: python examples/08_compare_presets.py [PRESET ...]
"""

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import spikingtac as st

SCENE, SECONDS, RATE_HZ = "finger-slides", 1.5, 500.0


def main(presets: Sequence[str]) -> dict[str, float]:
    """Print and return the mean error of each preset, px."""
    errors_px = {}
    with tempfile.TemporaryDirectory() as folder:
        st.simulate(st.load_scene(SCENE), folder, seed=1, duration_s=SECONDS)
        truth = st.Recording.open(folder).truth() or {}
        events = st.open_events(Path(folder))
        calibration = st.Calibration(
            reference_px=truth["reference_px"],
            radius_px=truth["radius_px"],
            grid=(8, 8),
            size=events.size,
        )
        for preset in presets:
            tracker = st.make_tracker(st.load_config(preset).tracking, calibration)
            tracks = st.Tracks.of(st.follow(events, tracker, RATE_HZ), calibration)
            found = st.compare_with_truth(tracks, truth["marker_t_us"], truth["marker_px"])
            figures = found.summary()
            errors_px[preset] = figures["error_mean_px"]
            print(f"{preset}: mean {figures['error_mean_px']:.3f} px (simulated), "
                  f"worst marker {figures['worst_marker']}")  # fmt: skip
    return errors_px


if __name__ == "__main__":
    main(sys.argv[1:] or ("default", "fast"))
