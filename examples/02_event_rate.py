"""Is a recording good? Its rate over time, the share of ON events, and the pixels that never rest.

Run: python examples/02_event_rate.py [FILE]

Without a file, a second of a simulated contact is looked at.
"""

import sys
from collections.abc import Iterable

import numpy as np

import spikingtac as st

PERIOD_US = 100_000
HOT_SHARE = 0.5  # A pixel is hot that sends in so many of the periods: others fall silent.


def main(source: Iterable[st.EventPacket], size: tuple[int, int]) -> None:
    """Print a line for each tenth of a second, then what the pixels sent."""
    width, height = size
    active = np.zeros((height, width), np.int64)  # periods in which a pixel sent
    periods = 0
    for window in st.windows(source, period_us=PERIOD_US):
        active[window.y, window.x] += 1
        periods += 1
        rate_kev_s = len(window) / PERIOD_US * 1e3
        on = f"{window.p.mean():.0%} ON" if len(window) else "silent"
        print(f"{window.t_start_us / 1e6:6.1f} s  {rate_kev_s:8.1f} thousand events a second, {on}")
    sent, hot = np.count_nonzero(active), np.count_nonzero(active > HOT_SHARE * periods)
    print(f"{sent} of {active.size} pixels sent events, {hot} of them are hot")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        events = st.open_events(sys.argv[1])
    else:
        events = st.SceneSource(st.load_scene("finger-presses"), seed=2, duration_s=1.0)
    main(events, events.size)
