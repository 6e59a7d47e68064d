"""Test for a misplaced skin: a sudden release overran the readout, and all discs stayed behind.

The discs agree with a map that got few events, so no fit notices. Two signs reveal it while the
discs stand still. The few events of the release make the map lighter where the markers rest.
Without any, the events of the next contact come from the rims at rest.
"""

import math
from typing import Any

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.hot_pixels import HOT
from spikingtac.kernels import kernel
from spikingtac.state_map.graded import Array, GradedStateMap

# Mean displacement from which a skin is tested, px (a few markers may stay behind), and the mean
# speed up to which it stands still, px/s: events that are lost in motion leave light at the rests,
# too, and rubs pass by them.
DISPLACED_PX, STILL_PX_S = 1.0, 15.0

# Distance from a disc beyond which the map is compared, px: nearer, a disc in motion leaves a
# trail. Points per marker that a comparison needs.
CLEAR_PX, LEAST_POINTS = 3.0, 1.0

# Rise of the contrast between the rests and their mirror images that reveals a release, in swings
# and in standard errors, and the time constant of the mean that it rises from, s. (Thirty
# simulated recordings, also without half of their events, rise by 5.2 standard errors at most, one
# of five that were calibrated without half of them by 6.02. Readouts of 0.3 to 1 Mev/s and dead
# times of 1 to 20 ms make it rise by 0.047 to 0.27, 6.5 to 36 standard errors.)
LIGHT_RISE, RISE_ERRORS, LIGHT_MEMORY_S = 0.03, 6.25, 0.1

# Farther way of the mean marker after which the light counts from anew, px: a fast hit leaves light
# at the rests as well, and its hold would pass for a release.
FARTHER_PX = 1.0

# Events since the last test, above twice their background, that call for a look at the rims. Their
# half width, px; events that there must be at the points on the rims at rest, and over those on the
# tracked rims. (Skins that stand still have 1.0 at most, misplaced ones 40 and more.)
NEW_EVENTS, RIM_PX, RIM_EVENTS, RIM_RATIO = 100, 2.5, 30, 4.0
ANGLES = np.arange(8) * (np.pi / 4.0)
RIM_COS, RIM_SIN = np.cos(ANGLES), np.sin(ANGLES)


class MisplacedSkin:
    """Decides whether all of one sensor's markers rest while they are tracked elsewhere."""

    def __init__(self, calibration: Calibration) -> None:
        """Begin with a skin at rest."""
        self._rest_px, self._light, self._away_px = calibration.reference_px, 0.0, 0.0

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
            state_map: The map, with its pixels' counts of events in half a second.
            counts: ``(m + 1,)`` events in each marker's gate, and last those in no gate.
            dt_s: Time in which they came, s.
            noise_per_s: ``(m + 1,)`` background events in the same places, 1/s.
        """
        light, error, away_px, at_rest, tracked = signs_kernel(
            state_map.values, state_map.pixels, self._rest_px, markers, counts, dt_s, noise_per_s
        )
        self._away_px = min(self._away_px, away_px)
        if away_px > self._away_px + FARTHER_PX:
            self._light, self._away_px = light, away_px
        rise = light - self._light
        self._light += rise * -math.expm1(-dt_s / LIGHT_MEMORY_S)
        released = rise > max(LIGHT_RISE, RISE_ERRORS * error)
        return released or at_rest >= max(RIM_EVENTS, RIM_RATIO * tracked)


@kernel()
def signs_kernel(
    levels: Array, pixels: Array, rest_px: Array, markers: Array, counts: Array, dt_s: float,
    noise_per_s: Array,
) -> tuple[float, float, float, float, float]:  # pragma: no cover - compiled # fmt: skip
    """Return the light at the rests and its standard error, and events on both kinds of rims.

    Between both stands the mean displacement, px. The error is infinite while the skin is at rest
    or in motion, or where there are too few points. Events are counted if the skin stands still and
    more of them come than the background.
    """
    light, error, points, away_px, speed_px_s = rest_light_kernel(levels, pixels, rest_px, markers)
    still = away_px >= DISPLACED_PX and speed_px_s <= STILL_PX_S
    at_rest = tracked = 0.0
    if still and counts.sum() >= NEW_EVENTS + 2.0 * dt_s * noise_per_s.sum():
        at_rest, tracked = rim_events_kernel(pixels, rest_px, markers)
    error = error if still and points >= LEAST_POINTS else np.inf
    return light, error, away_px, at_rest, tracked


@kernel()
def rest_light_kernel(
    levels: Any, pixels: Any, rest_px: Any, markers: Any
) -> tuple[float, float, float, float, float]:  # pragma: no cover - compiled
    """Return how much lighter the map is at the rests than at their mirror images.

    Points on the line from a marker to its rest, beyond the disc and within the disc at rest, are
    compared with those opposite, unless another marker is near. The other values are the standard
    error, points per marker, the mean displacement, px, and the mean speed, px/s.
    """
    (height, width), count = pixels.shape, len(markers)
    light = squares = points = displacement = speed = 0.0
    for m in range(count):
        marker = markers[m]
        to_x, to_y = rest_px[m, 0] - marker.x, rest_px[m, 1] - marker.y
        away = np.hypot(to_x, to_y)
        displacement, speed = displacement + away, speed + np.hypot(marker.vx, marker.vy)
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
    return light, error, points / count, displacement / count, speed / count


@kernel()
def rim_events_kernel(
    pixels: Any, rest_px: Array, markers: Array
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Return the events on the rims at rest and on the tracked rims, without those on both."""
    height, width = pixels.shape
    at_rest = tracked = 0.0
    for m in range(len(markers)):
        radius = markers[m].radius_px
        rest, now = (rest_px[m, 0], rest_px[m, 1]), (markers[m].x, markers[m].y)
        for k in range(RIM_COS.size):
            for here, other in ((rest, now), (now, rest)):
                for off in range(-int(RIM_PX), int(RIM_PX) + 1, 2):
                    x = round(here[0] + (radius + off) * RIM_COS[k])
                    y = round(here[1] + (radius + off) * RIM_SIN[k])
                    if min(x, y) < 0 or x >= width or y >= height or pixels[y, x].alone == HOT:
                        continue
                    if abs(np.sqrt((x - other[0]) ** 2 + (y - other[1]) ** 2) - radius) > RIM_PX:
                        at_rest += pixels[y, x].events * (here == rest)
                        tracked += pixels[y, x].events * (here == now)
    return at_rest, tracked
