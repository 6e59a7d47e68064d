"""Learn where the markers of a sensor rest, say how well, and compare it with the truth.

Run: python examples/05_calibrate.py [FILE] [calibration.json]

Without a file, the slides of the simulated sensor are used, whose rest positions are known.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import spikingtac as st

PITCH_MM = 2.4  # Distance of neighbouring markers on the simulated skin; measure that of yours.
SECONDS = 5.4  # Four of the eight slides are enough.


def main(recording: str | Path, output: str | Path) -> st.Calibration:
    """Calibrate, print the quality, and write the file."""
    calibration = st.calibrate(st.open_events(recording), st.CalibrationConfig(pitch_mm=PITCH_MM))
    calibration.save(output)
    rows, columns = calibration.grid
    print(f"{rows} x {columns} markers, quality: {calibration.provenance['quality']}")
    print(f"{calibration.px_per_mm:.2f} px/mm, radius {calibration.radius_px.mean():.2f} px")
    print(f"expected from their neighbours: {calibration.provenance['missing'] or 'none'}")
    return calibration


if __name__ == "__main__":
    target = sys.argv[2] if len(sys.argv) > 2 else "calibration.json"
    if len(sys.argv) > 1:
        main(sys.argv[1], target)
    else:
        with tempfile.TemporaryDirectory() as folder:
            st.simulate(st.load_scene("bootstrap"), folder, seed=1, duration_s=SECONDS)
            learned = main(folder, target)
            truth = st.Recording.open(folder).truth() or {}
        apart_px = np.hypot(*(learned.reference_px - truth["reference_px"]).T)
        print(f"rest positions err by {apart_px.mean():.3f} px (simulated)")
