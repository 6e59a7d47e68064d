"""A tracker of your own, in the place of this package's: three methods, and the rest works.

Run: python examples/10_your_own_tracker.py
"""

import numpy as np

import spikingtac as st

SHARE = 0.005  # By how much an event draws its marker towards itself.


class EventCentroids:
    """Each marker is where its last events were: a simple example, not a good tracker."""

    def __init__(self, calibration: st.Calibration) -> None:
        self._rest_px = calibration.reference_px
        self.reset()

    def reset(self) -> None:
        """Forget everything but the calibration."""
        self._position_px = self._rest_px.copy()
        self._seen = np.zeros(len(self._rest_px), bool)

    def absorb(self, packet: st.EventPacket) -> None:
        """Draw the nearest marker towards each event."""
        for x, y in zip(packet.x.tolist(), packet.y.tolist(), strict=True):
            away_px = (x, y) - self._position_px
            marker = int((away_px**2).sum(axis=1).argmin())
            self._position_px[marker] += SHARE * away_px[marker]
            self._seen[marker] = True

    def estimate(self, t_us: int) -> st.MarkerFrame:
        """Return where the markers are."""
        position_px = self._position_px.copy()
        moved_px = position_px - self._rest_px
        seen = self._seen.copy()
        return st.MarkerFrame(t_us, position_px, position_px, moved_px, ~seen, seen.astype(float))


def main() -> st.Tracks:
    """Track a second of a contact with it."""
    source = st.SceneSource(st.load_scene("finger-slides"), seed=1, duration_s=1.0)
    calibration = st.Calibration(
        reference_px=source.reference_px,
        radius_px=source.radius_px,
        grid=(8, 8),
        size=source.size,
    )
    tracker: st.MarkerTracker = EventCentroids(calibration)
    tracks = st.Tracks.of(st.follow(source, tracker, rate_hz=200.0), calibration)
    print(tracks)
    return tracks


if __name__ == "__main__":
    main()
