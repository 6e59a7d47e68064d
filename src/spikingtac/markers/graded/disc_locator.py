"""Track markers by event-driven disc fits on the graded map, one Kalman filter for each marker.

A marker is fitted when enough events fall into its gate, the pixels around its predicted disc. A
map without new events would give the same fit again, so a quiet marker's last fit serves as the
next measurement. Each pixel holds the number of the marker in whose gate it lies, so that an event
finds its marker by one look-up.
"""

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import Discs
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import CalibrationError
from spikingtac.events.hot_pixels import HotPixelWatch, heard_kernel
from spikingtac.kernels import kernel
from spikingtac.markers.graded.appearance import (
    MOST_RADIUS_PX,
    FitWindow,
    dead_time_of,
    events_per_px,
    fit_window,
    painted_map,
)
from spikingtac.markers.graded.dead_bands import fit_bands_kernel, signal_share_kernel
from spikingtac.markers.graded.disc_fit import (
    LINEAR_STEP_PX,
    MOST_GROWTH,
    fit_disc_kernel,
    fit_scratch,
)
from spikingtac.markers.graded.motion import (
    FIT_NOW,
    MEASUREMENT_PERIOD_S,
    NEVER_US,
    REASSIGN_PX,
    assign_pixels_kernel,
    correct_kernel,
    fit_is_due_kernel,
    predict_kernel,
    resting_markers,
)
from spikingtac.state_map.graded import HALF_STEP, PAD_PX, Array, integrate_event_kernel
from spikingtac.types import EventPacket, FloatArray

# Most Gauss-Newton steps of a disc fit: two suffice on average, a sudden release takes more.
ITERATIONS = 3

# Longest time over which a motion is predicted, s: several times that between two estimates. Longer
# ones are leaps of a clock, or a camera was unplugged.
LONGEST_WAY_S = 0.01

# Least share of the time that a pixel is believed to see, and time between events from which all of
# it is, in dead times.
LEAST_SEEN, FAST_DEAD_TIMES = 0.25, 20.0

# How far outside of a disc the leak works, px. (At 5 px a marker is lost at a snap of the twin; at
# 3.5 px v2e's recording without 30 % of its events errs by 2 % more.)
OUTER_PX = 4.0

STILL_PX_S = 0.2  # Filtered speed below which a marker without new events is not predicted.

DUE_PX = 0.02  # Motion that causes as many events as a fit needs, px.

# Rate at which an outline follows its fits, 1/s (indentation and strain take tens of ms).
OUTLINE_PER_S = 150.0


class DiscLocator:
    """Filters of one sensor's markers, and the map of levels to which their discs are fitted.

    Attributes:
        map: The graded state map.
        hot: Pixels that are or become hot; their events are ignored.
        window: The pixels that fits read, and the edge profiles of the markers.
        scratch: For the pixels of a disc, in fits and in the leak.
        markers: ``(m,)`` records (:data:`~spikingtac.markers.graded.motion.MARKER`).
        outline_px: ``(m, 3)`` radius and second harmonic of each disc, px.
        pending: ``(m + 1,)`` events in each marker's gate since its last fit; the last element
            counts the events in no gate, so that counting needs no branch, which would cost half as
            much again.
        fitted_events: ``(m + 1,)`` events in each marker's gate before its last fit.
        times_us: Times of the last two estimates, us; NEVER_US before there were any.
    """

    def __init__(self, calibration: Calibration, dead_bands: bool = False) -> None:
        """Begin at rest, with the map painted from the calibration.

        Args:
            calibration: Rest positions and appearance of the markers.
            dead_bands: Whether discs are fitted to dead bands instead of levels
                (:mod:`spikingtac.markers.graded.dead_bands`).

        Raises:
            CalibrationError: A disc is too large to be fitted.
        """
        radius_px = calibration.radius_px.astype(np.float64)
        if radius_px.max() > MOST_RADIUS_PX:
            raise CalibrationError(
                f"a marker's radius is {radius_px.max():.1f} px; discs of at most "
                f"{MOST_RADIUS_PX:g} px are followed: see the skin from farther away"
            )
        most_px = (1.0 + MOST_GROWTH) * radius_px.max()
        self.window = fit_window(Discs.of(calibration), calibration.size[0], most_px)
        self.scratch = fit_scratch(most_px + max(self.window.edge[:, 1].max(), OUTER_PX))
        self._at_rest = resting_markers(calibration.reference_px)
        self._at_rest["radius_px"] = radius_px
        self._at_rest["needed"] = np.ceil(DUE_PX * events_per_px(calibration)).clip(1.0)
        self._dead_bands = dead_bands
        self._dead_us, self._calibration = dead_time_of(calibration), calibration
        self.map = painted_map(calibration, 0.0 if dead_bands else HALF_STEP)
        self.reset()

    def reset(self) -> None:
        """Forget everything but the calibration: the markers rest, the map is as painted."""
        count, pixels = len(self._at_rest), self.map.pixels
        self.map.reset()
        self.hot = HotPixelWatch(self._calibration.hot_px, self._calibration.size, pixels)
        self.markers = self._at_rest.copy()
        self.outline_px = np.pad(self.markers["radius_px"][:, np.newaxis], ((0, 0), (0, 2)))
        self.pending, self.fitted_events = np.zeros((2, count + 1), np.int64)
        self.times_us = NEVER_US, NEVER_US
        states = self.markers, self.outline_px
        self._arrays = *self.window, *states, self.pending, self.fitted_events, pixels
        pixels["marker"] = count
        for m in range(count):
            assign_pixels_kernel(pixels, m, *states, self.window.edge)
        self.area_px = np.bincount(pixels["marker"].ravel(), minlength=count + 1)

    @property
    def event_count(self) -> NDArray[np.int64]:
        """``(m + 1,)`` all events so far in each marker's gate, and last those in no gate."""
        return self.fitted_events + (self.pending & (FIT_NOW - 1))

    def place(self, marker: NDArray[np.bool_], position_px: FloatArray) -> None:
        """Set the filters of markers to rest at positions where they were predicted or detected."""
        self.markers["x"][marker], self.markers["y"][marker] = position_px[marker].T
        self.markers["vx"][marker] = self.markers["vy"][marker] = 0.0
        self.pending[:-1][marker] |= FIT_NOW

    def absorb(self, packet: EventPacket) -> None:
        """Integrate events into the map and count them per marker, without those of hot pixels.

        Raises:
            ConfigError: The packet comes from a sensor of another size.
        """
        levels, known = self.map, self.hot.found
        settings = levels.dark_markers, levels.lead_steps, levels.arrival_ratio, self._dead_us
        maps = levels.pixels, levels.padded, *settings, self.pending
        for part in self.hot.parts(packet):
            absorb_events_kernel(part.t, part.x, part.y, part.p, *maps)
        if self.hot.found > known:  # no more events of these pixels reach the map
            levels.restore(self.hot.hot)

    def locate(self, t_us: int, coasted: NDArray[np.bool_], noise_hz_px: float = 0.0) -> None:
        """Fit the markers that are due at ``t_us``, and update their filters.

        Args:
            t_us: Time of the estimate, us.
            coasted: ``(m,)`` lost markers: they keep their position, their velocity is 0.
            noise_hz_px: Background, Hz/px, from which fits to dead bands tell motion.
        """
        times_us = self.times_us = self.times_us[1], t_us
        maps = self.map.padded.ravel(), self.scratch, self._dead_bands
        locate_discs_kernel(*maps, *self._arrays, coasted, times_us, self.area_px, noise_hz_px)


@kernel()
def absorb_events_kernel(
    t: Array, x: Array, y: Array, p: Array, pixels: Array, padded: Array, dark_markers: bool,
    lead: float, ratio: float, dead_us: float, pending: Array,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Add each event's step to the map, and count the event for the marker whose gate it is in.

    Of events that follow fast, those that the motion caused in a pixel's dead time are missing.
    Arguments are plain, since a tuple costs time: columns of the events; the map's pixels, its
    levels with their margin, and its settings; pending events of the markers.
    """
    fast_us = np.uint32(FAST_DEAD_TIMES * dead_us)
    for i in range(x.size):
        # Unsigned, so that no index can be meant from the end.
        row, column = np.uint64(y[i]), np.uint64(x[i])
        pixel = pixels[row, column]
        if heard_kernel(pixel):
            rises, arrives = p[i] != dark_markers, ratio
            direction = np.uint32(2 if rises else 1)
            since_us = np.uint32(np.uint32(t[i]) - pixel.last_us)
            if direction == pixel.direction and 0 < since_us < fast_us:
                arrives *= max((since_us - dead_us) / since_us, LEAST_SEEN)
            pixel.last_us, pixel.direction = np.uint32(t[i]), direction
            shown = integrate_event_kernel(pixel, rises, lead, arrives)
            padded[row + np.uint64(PAD_PX), column + np.uint64(PAD_PX)] = shown
            pending[pixel.marker] += 1


@kernel()
def locate_discs_kernel(
    flat: Array, scratch: Array, dead_bands: bool, offset: Array, polar: Array, within: Array,
    coefficients: Array, edge: Array, markers: Array, outline_px: Array, pending: Array,
    fitted_events: Array, pixels: Array, coasted: Array, times_us: tuple[int, int],
    area_px: Array, noise_hz_px: float,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Fit the markers that are due, and predict and correct their filters.

    Arguments are plain, since a tuple costs a microsecond: the flat map with its margin, scratch
    for fits, and whether they are fits to dead bands; the fields of a :class:`FitWindow`; records,
    outlines, pending and fitted events of the markers; the map's pixels; lost markers; times of the
    last estimate and of this one, us; pixels in each gate, and the background, Hz/px.
    """
    levels, t_us = (flat, pixels.shape[1], pixels.shape[0]), times_us[1]
    window = FitWindow(offset, polar, within, coefficients, edge)
    for m in range(len(markers)):
        marker = markers[m]
        if marker.t_us == NEVER_US:
            marker.fit_us = marker.quiet_us = marker.t_us = t_us
        dt_s = (t_us - marker.t_us) * 1e-6
        is_due = fit_is_due_kernel(m, markers, pending[m], dead_bands, times_us)
        if not is_due and (pending[m] > 0 or dt_s < MEASUREMENT_PERIOD_S):
            continue
        marker.t_us = t_us
        if not is_due and abs(marker.vx) + abs(marker.vy) < STILL_PX_S:
            continue
        predict_kernel(marker, min(dt_s, LONGEST_WAY_S))
        if is_due:
            gain = 1.0 - np.exp(-1e-6 * OUTLINE_PER_S * (t_us - marker.fit_us))
            start = m, (marker.x, marker.y), outline_px, (ITERATIONS, gain, marker.radius_px)
            if dead_bands:
                noise_per_s = noise_hz_px * area_px[m]
                signal = signal_share_kernel(marker, pending[m] % FIT_NOW, noise_per_s, t_us)
                fit = fit_bands_kernel(pixels, levels, scratch, window, *start, signal)
            else:
                fit = fit_disc_kernel(levels, scratch, window, *start)
            x, y, marker.agreement, step_px = fit
            marker.innovation_px = np.hypot(x - marker.x, y - marker.y)
            marker.fit_x, marker.fit_y, marker.fit_us = x, y, t_us
            fitted_events[m] += pending[m] % FIT_NOW
            pending[m] = FIT_NOW if step_px >= LINEAR_STEP_PX else 0  # goes on if not converged
        if coasted[m]:
            marker.vx = marker.vy = 0.0
        else:
            correct_kernel(marker, marker.fit_x, marker.fit_y, dt_s)
        if max(abs(marker.x - marker.gate_x), abs(marker.y - marker.gate_y)) > REASSIGN_PX:
            assign_pixels_kernel(pixels, m, markers, outline_px, edge)
