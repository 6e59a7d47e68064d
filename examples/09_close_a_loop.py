"""A control loop: contact at once, displacement at 100 Hz, from one stream of events.

Run: python examples/09_close_a_loop.py

Not a safety function. The stream is simulated; a camera's address in st.open_events is live.
"""

from itertools import islice

import numpy as np

import spikingtac as st

QUIET_WINDOWS, CONTROL_US = 300, 10_000
WANTED_PX, GAIN = 1.0, 0.05


def main() -> list[float]:
    """Run the loop over two seconds of presses and return the commands."""
    source = st.SceneSource(st.load_scene("finger-presses"), seed=1, duration_s=2.0)
    calibration = st.Calibration(
        reference_px=source.reference_px,
        radius_px=source.radius_px,
        grid=(8, 8),
        size=source.size,
    )
    tracker = st.make_tracker(st.load_config("fast").tracking, calibration)
    stream = st.windows(source, period_us=1_000)
    quiet = list(islice(stream, QUIET_WINDOWS))
    contact = st.EventCountDetector.from_quiet(st.QuietStatistics.of(quiet))
    for window in quiet:
        tracker.absorb(window)

    grip, commands = 0.0, []
    for window in stream:
        if hit := contact.update(window):
            print(f"{hit.t_us / 1e6:.3f} s: contact")
        tracker.absorb(window)
        if window.t_end_us % CONTROL_US == 0:
            frame = tracker.estimate(window.t_end_us)
            seen_px = frame.displacement_px[~frame.coasted]
            moved_px = float(np.hypot(*seen_px.T).mean()) if len(seen_px) else 0.0
            grip += GAIN * (WANTED_PX - moved_px)
            commands.append(grip)
    print(f"{len(commands)} commands, from {min(commands):.2f} to {max(commands):.2f}")
    return commands


if __name__ == "__main__":
    main()
