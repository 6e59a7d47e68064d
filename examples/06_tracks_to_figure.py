"""Track a contact, print its figures, and draw it for a paper.

Run: python examples/06_tracks_to_figure.py [field.pdf]
"""

import sys
from pathlib import Path

import spikingtac as st

RATE_HZ, PITCH_MM, LAST_COLUMN = 500.0, 2.4, 7


def known_calibration(source: st.SceneSource) -> st.Calibration:
    """Return the calibration of a simulated sensor; a real one is learned (05_calibrate.py)."""
    pitch_px = (source.reference_px[LAST_COLUMN] - source.reference_px[0])[0] / LAST_COLUMN
    return st.Calibration(
        reference_px=source.reference_px,
        radius_px=source.radius_px,
        grid=(8, 8),
        size=source.size,
        px_per_mm=float(pitch_px) / PITCH_MM,
    )


def main(picture: str | Path) -> st.Tracks:
    """Track two seconds of a twisting finger, and draw the field where it is largest."""
    source = st.SceneSource(st.load_scene("finger-torsion"), seed=1, duration_s=2.0)
    calibration = known_calibration(source)
    tracker = st.make_tracker(st.load_config("default").tracking, calibration)
    tracks = st.Tracks.of(st.follow(source, tracker, RATE_HZ), calibration)
    print(tracks)
    largest = tracks.summary()
    print(
        f"marker {largest['displacement_max_marker']} moved by "
        f"{largest['displacement_max_mm']:.2f} mm"
    )
    tracks.plot("field").savefig(picture)
    return tracks


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "field.pdf")
