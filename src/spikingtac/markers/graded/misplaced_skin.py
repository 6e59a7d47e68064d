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
from spikingtac.markers.graded.appearance import steps_of
from spikingtac.state_map.graded import Array, GradedStateMap

# Mean displacement from which a skin is tested, px (a few markers may stay behind), and the mean
# speed up to which it stands still, px/s: events that are lost in motion leave light at the rests,
# too, and rubs pass by them.
DISPLACED_PX, STILL_PX_S = 1.0, 15.0

# Distance from a disc beyond which the map is compared, px: nearer, a disc in motion leaves a
# trail. Points of a marker, and markers, that a comparison needs.
CLEAR_PX, LEAST_POINTS, LEAST_MARKERS = 3.0, 2, 3

# Distances of the lines of points from the one through marker and rest, px. (With that one alone
# fewer releases are seen.)
LINES_PX = (-3.0, 0.0, 3.0)

# Rise of the contrast between a rest and its mirror image that reveals a release, mean over the
# markers, in swings and in standard errors; time constant of the contrast from which it rises, s.
# (Ninety simulated recordings without a misplaced skin: 0.11 at most where it is 5 errors, at slips
# that are stamped in batches of 10 ms. Releases at readouts of 0.5 to 2 Mev/s: 0.2 to 0.43, and 5
# to 20; without nine tenths of their events 0.13, and 15.)
LIGHT_RISE, RISE_ERRORS, LIGHT_MEMORY_S = 0.12, 5.0, 0.1

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
        self._rest_px, self._away_px = calibration.reference_px, 0.0
        self._light = np.full(len(self._rest_px), np.nan)
        self._recovers = calibration.recovery_s is not None
        # A pixel that its disc has left keeps up to a step of light, half of one on average.
        self._rise = max(LIGHT_RISE, 0.5 * float(steps_of(calibration).mean(axis=1).max()))

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
        # Pixels that recover lighten by themselves, by 0.19 of a swing on the recorded sensor.
        if self._recovers:
            self._light[:] = np.nan
        misplaced, self._away_px = misplaced_kernel(
            state_map.values, state_map.pixels, self._rest_px, markers, self._light, self._rise,
            self._away_px, counts, dt_s, noise_per_s,
        )  # fmt: skip
        return misplaced


@kernel()
def misplaced_kernel(
    levels: Array, pixels: Array, rest_px: Array, markers: Array, light: Array, rise: float,
    nearest_px: float, counts: Array, dt_s: float, noise_per_s: Array,
) -> tuple[bool, float]:  # pragma: no cover - compiled # fmt: skip
    """Return whether a skin that stands still is misplaced, and its least displacement, px.

    The light counts from anew, and that displacement with it, when the skin goes farther. Events on
    the rims are looked at if more of them come than the background.
    """
    away_px, speed_px_s = mean_motion_kernel(rest_px, markers)
    nearest_px = min(nearest_px, away_px)
    if away_px > nearest_px + FARTHER_PX:
        light[:], nearest_px = np.nan, away_px
    if away_px < DISPLACED_PX or speed_px_s > STILL_PX_S:
        return False, nearest_px
    share = -math.expm1(-dt_s / LIGHT_MEMORY_S)
    risen, error = light_rise_kernel(levels, pixels, rest_px, markers, light, share)
    if risen > max(rise, RISE_ERRORS * error):
        return True, nearest_px
    if counts.sum() < NEW_EVENTS + 2.0 * dt_s * noise_per_s.sum():
        return False, nearest_px
    at_rest, tracked = rim_events_kernel(pixels, rest_px, markers)
    return at_rest >= max(RIM_EVENTS, RIM_RATIO * tracked), nearest_px


@kernel()
def mean_motion_kernel(
    rest_px: Array, markers: Array
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Return the mean displacement, px, and the mean speed, px/s."""
    away = speed = 0.0
    for m in range(len(markers)):
        away += np.hypot(markers[m].x - rest_px[m, 0], markers[m].y - rest_px[m, 1])
        speed += np.hypot(markers[m].vx, markers[m].vy)
    return away / len(markers), speed / len(markers)


@kernel()
def light_rise_kernel(
    levels: Any, pixels: Any, rest_px: Any, markers: Any, light: Array, share: float
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Return the mean rise of the light at the markers' rests, and its standard error.

    Points on the way from a marker to its rest, beyond the disc and within the disc at rest, are
    compared with those opposite, unless another marker is near. ``light`` holds each marker's mean
    contrast so far, NaN before the first; a share of its rise is added to it. The error is infinite
    for too few markers.
    """
    (height, width), count = pixels.shape, len(markers)
    seen = total = squares = 0.0
    for m in range(count):
        marker, contrast, points = markers[m], 0.0, 0
        to_x, to_y = rest_px[m, 0] - marker.x, rest_px[m, 1] - marker.y
        away = np.hypot(to_x, to_y)
        ends = int(marker.radius_px + CLEAR_PX), int(away + marker.radius_px)
        for s, k in np.ndindex(max(ends[1] - ends[0], 0), len(LINES_PX)):
            along_x, along_y = (ends[0] + s) * to_x / away, (ends[0] + s) * to_y / away
            across_x, across_y = -LINES_PX[k] * to_y / away, LINES_PX[k] * to_x / away
            x, y = round(marker.x + along_x + across_x), round(marker.y + along_y + across_y)
            mirror_x, mirror_y = round(2.0 * marker.x - x), round(2.0 * marker.y - y)
            if min(x, mirror_x) < 0 or max(x, mirror_x) >= width:
                continue
            if min(y, mirror_y) < 0 or max(y, mirror_y) >= height:
                continue
            gates = pixels[y, x].marker, pixels[mirror_y, mirror_x].marker
            if gates[0] in (m, count) and gates[1] in (m, count):
                contrast += levels[y, x] - levels[mirror_y, mirror_x]
                points += 1
        if points >= LEAST_POINTS:
            rise = contrast / points - light[m]
            if np.isnan(rise):
                light[m] = contrast / points
                continue
            light[m] += share * rise
            seen, total, squares = seen + 1.0, total + rise, squares + rise**2
    if seen < LEAST_MARKERS:
        return 0.0, np.inf
    mean = total / seen
    return mean, np.sqrt(max(squares / seen - mean**2, 0.0) / (seen - 1.0))


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
