"""Test for a misplaced skin: a sudden release overran the readout, and all discs stayed behind.

The discs agree with a map that got few events, so no fit notices. Two signs reveal it. The few
events of the release make the map brighter where the markers rest. Without any, the events of the
next contact come from the rims at rest.
"""

import math

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.hot_pixels import HOT
from spikingtac.kernels import kernel
from spikingtac.markers.graded.appearance import nearest_marker
from spikingtac.state_map.graded import Array, GradedStateMap

# Mean displacement from which a skin is tested for being misplaced, px, and the events in no gate
# since the last test that call for one, above twice their background.
DISPLACED_PX, STRAY_EVENTS = 2.0, 100

# Half of the width of a rim in which events are counted, px; how many there must be at rest, and
# over those at the tracked rims. (After a press as fast as the readout allows both are alike.)
RIM_PX, RIM_EVENTS, RIM_RATIO = 2.5, 300, 2.0

# Distance from a disc beyond which the map is compared, px: nearer, a disc in motion leaves a
# trail. Points per marker that a comparison needs, and the largest mean speed, px/s: events that
# are lost in motion leave a trail, too.
CLEAR_PX, LEAST_POINTS, STILL_PX_S = 3.0, 1.0, 15.0

# Rise of the contrast between the rests and their mirror images that reveals a release, in swings
# and in standard errors, and the time constant of the mean that it rises from, s. (Thirty
# simulated recordings, also without half of their events, rise by 5.2 standard errors at most.
# Readouts of 0.3 to 1 Mev/s and dead times of 1 to 20 ms make it rise by 0.047 to 0.27, 6.5 to 36
# standard errors.)
LIGHT_RISE, RISE_ERRORS, LIGHT_MEMORY_S = 0.03, 6.0, 0.1


class MisplacedSkin:
    """Decides whether all of one sensor's markers rest while they are tracked elsewhere."""

    def __init__(self, calibration: Calibration) -> None:
        """Begin with a skin at rest."""
        self._rest_px = calibration.reference_px
        self._nearest = nearest_marker(calibration.reference_px, calibration.size)
        self._light = 0.0

    def update(
        self,
        markers: Array,
        state_map: GradedStateMap,
        counts: Array,
        dt_s: float,
        noise_per_s: Array,
    ) -> bool:
        """Return whether the skin is misplaced.

        Args:
            markers: ``(m,)`` records (:data:`~spikingtac.markers.graded.motion.MARKER`).
            state_map: The map, with its pixels' counts of events.
            counts: ``(m + 1,)`` events in each marker's gate, and last those in no gate.
            dt_s: Time in which they came, s.
            noise_per_s: ``(m + 1,)`` background events in the same places, 1/s.
        """
        maps = state_map.values, state_map.pixels
        light, error, comparable = rest_light_kernel(*maps, self._rest_px, markers)
        rise = light - self._light
        self._light += rise * -math.expm1(-dt_s / LIGHT_MEMORY_S)
        released = comparable and rise > max(LIGHT_RISE, RISE_ERRORS * error)
        stray = bool(counts[-1] >= STRAY_EVENTS + 2.0 * noise_per_s[-1] * dt_s)
        return released or rim_events_kernel(stray, maps[1], self._nearest, self._rest_px, markers)


@kernel()
def rest_light_kernel(
    levels: Array, pixels: Array, rest_px: Array, markers: Array
) -> tuple[float, float, bool]:  # pragma: no cover - compiled
    """Return how much brighter the map is at the rests than at their mirror images.

    Points on the line from a marker to its rest, beyond the disc and within the disc at rest, are
    compared with those opposite, unless another marker is near. The second value is the standard
    error, the third tells whether there were enough points, and the skin is still.
    """
    (height, width), count = pixels.shape, len(markers)
    light = squares = points = speed = 0.0
    for m in range(count):
        marker = markers[m]
        to_x, to_y = rest_px[m, 0] - marker.x, rest_px[m, 1] - marker.y
        away = np.hypot(to_x, to_y)
        speed += np.hypot(marker.vx, marker.vy)
        for s in range(int(marker.radius_px + CLEAR_PX), int(away + marker.radius_px)):
            x, y = round(marker.x + s * to_x / away), round(marker.y + s * to_y / away)
            mirror_x, mirror_y = round(2.0 * marker.x - x), round(2.0 * marker.y - y)
            if min(x, mirror_x) < 0 or max(x, mirror_x) >= width:
                continue
            if min(y, mirror_y) < 0 or max(y, mirror_y) >= height:
                continue
            gates = pixels[y, x].marker, pixels[mirror_y, mirror_x].marker
            if gates[0] in (m, count) and gates[1] in (m, count):
                contrast = levels[y, x] - levels[mirror_y, mirror_x]
                light, squares, points = light + contrast, squares + contrast**2, points + 1.0
    per_point = 1.0 / max(points, 1.0)
    light *= per_point
    error = np.sqrt(max(squares * per_point - light**2, 0.0) * per_point)
    return light, error, points >= LEAST_POINTS * count and speed < STILL_PX_S * count


@kernel()
def rim_events_kernel(
    stray: bool, pixels: Array, nearest: Array, rest_px: Array, markers: Array
) -> bool:  # pragma: no cover - compiled
    """Compare, if any are stray, the events on the rims at rest with those on the tracked rims."""
    away = at_rest = tracked = 0.0
    for m in range(len(markers)):
        away += np.hypot(markers[m].x - rest_px[m, 0], markers[m].y - rest_px[m, 1])
    for y in range(pixels.shape[0] if stray and away >= DISPLACED_PX * len(markers) else 0):
        for x in range(pixels.shape[1]):
            m, count = nearest[y, x], pixels[y, x].events * (pixels[y, x].alone != HOT)
            if count:
                rest = np.hypot(x - rest_px[m, 0], y - rest_px[m, 1])
                now = np.hypot(x - markers[m].x, y - markers[m].y)
                at_rest += count * (abs(rest - markers[m].radius_px) < RIM_PX)
                tracked += count * (abs(now - markers[m].radius_px) < RIM_PX)
    return at_rest >= max(RIM_EVENTS, RIM_RATIO * tracked)
