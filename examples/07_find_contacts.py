"""Find contacts in raw events, window by window, without any tracker or calibration.

Run: python examples/07_find_contacts.py [FILE]
"""

import sys
from collections.abc import Iterable
from itertools import islice

import spikingtac as st

QUIET_WINDOWS = 300  # Windows of 1 ms at the beginning in which nothing may touch the skin.


def main(packets: Iterable[st.EventPacket]) -> list[st.Contact]:
    """Print and return the contacts."""
    windows = st.windows(packets, period_us=1_000)
    quiet = st.QuietStatistics.of(islice(windows, QUIET_WINDOWS))
    detector = st.EventCountDetector.from_quiet(quiet, false_alarms_per_hour=1.0)
    print(
        f"{quiet.mean:.1f} events in a quiet window; a contact has more than {detector.threshold}"
    )
    contacts = [hit for window in windows if (hit := detector.update(window))]
    for hit in contacts:
        print(f"contact at {hit.t_us / 1e6:.3f} s: {hit.count:.0f} events in a millisecond")
    return contacts


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(st.open_events(sys.argv[1]))
    else:
        main(st.SceneSource(st.load_scene("finger-presses"), seed=1, duration_s=2.0))
