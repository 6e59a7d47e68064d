"""Locate markers by disc fits on the graded map, each one when its events ask for it.

A map without new events gives the same fit again: silence measures the last place once more, and
costs nothing. Which marker an event asks for is read from an index: each marker marks the pixels
around its disc where it stands.
"""

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.hot_pixels import HotPixelWatch, heard_kernel
from spikingtac.kernels import kernel
from spikingtac.markers.graded.appearance import (
    FitWindow,
    appearance_of,
    events_per_px,
    fit_window,
    painted_map,
)
from spikingtac.markers.graded.dead_bands import fit_bands_kernel
from spikingtac.markers.graded.disc_fit import (
    LINEAR_STEP_PX,
    MOST_GROWTH,
    fit_disc_kernel,
    fit_scratch,
)
from spikingtac.markers.graded.motion import (
    AGREEMENT,
    AT_ONCE,
    AT_US,
    FIT_US,
    FIT_X,
    FIT_Y,
    MARKED_PX,
    MARKED_X,
    MARKED_Y,
    MEASUREMENT_PERIOD_S,
    NEVER_US,
    OFF_PX,
    OUTLINED_US,
    SILENT_US,
    VX,
    VY,
    X,
    Y,
    asks_kernel,
    correct_kernel,
    mark_kernel,
    predict_kernel,
    resting_motion,
)
from spikingtac.state_map.graded import HALF_STEP, PAD_PX, Array, integrate_event_kernel
from spikingtac.types import EventPacket

# Gauss-Newton steps of a disc fit at most: two suffice on average, a sudden release takes more.
ITERATIONS = 3

STILL_PX_S = 0.2  # Filtered speed below which a marker without new events is not moved on.

DUE_PX = 0.02  # Motion whose events ask for a fit in the marker's turn, px.

# Rate at which an outline follows what the fit sees, 1/s (indentation and strain take tens
# of ms).
OUTLINE_PER_S = 150.0

# Shortest time between two fits of an outline, which tell the agreement, us (at 2,000 the leak
# notices a marker that snaps back too late, and erases it).
OUTLINE_US = 1_000


class DiscLocator:
    """The states of one sensor's markers, and the map in which robust fits find them.

    Attributes:
        map: The map that it reads.
        window: The pixels that fits read, and the edges of the markers.
        motion: ``(m, 8)`` states of the markers (:mod:`spikingtac.markers.graded.motion`).
        fits: ``(m, 9)`` what was fitted last, by the columns there.
        outline_px: ``(m, 3)`` radius and second harmonic of each disc, px.
        pending: ``(m + 1,)`` events around each marker since its last fit, and those around none:
            so no event needs a branch, which would cost half as much again.
        answered: ``(m + 1,)`` those before: events around each marker until its last fit.
        times_us: When the last two estimates were made, us; NEVER_US before there were any.
    """

    def __init__(self, calibration: Calibration, dead_bands: bool = False) -> None:
        """Begin at rest, with the pixels and the profiles for a sensor's markers.

        Args:
            calibration: Where the markers rest and how they look.
            dead_bands: Whether levels are known within their dead bands only
                (:mod:`spikingtac.markers.graded.dead_bands`).
        """
        self._start_px = calibration.reference_px.astype(np.float64)
        self._radius_px = calibration.radius_px.astype(np.float64)
        profiles = appearance_of(calibration).profiles
        self.window = fit_window(profiles, calibration.size[0])
        reach_px = (1.0 + MOST_GROWTH) * self._radius_px.max() + self.window.edge[:, 1].max()
        self._scratch = fit_scratch(reach_px)
        per_px = events_per_px(calibration)
        self._due = np.maximum(np.ceil(DUE_PX * per_px), 1.0)
        self._bands = dead_bands
        self.map = painted_map(calibration, 0.0 if dead_bands else HALF_STEP)
        self.reset()

    def reset(self) -> None:
        """Forget everything but the calibration: the markers rest, the map is as painted."""
        count = len(self._start_px)
        self.map.reset()
        self.motion = resting_motion(self._start_px)
        self.fits = np.zeros((count, 9))
        self.fits[:, :FIT_US] = self.fits[:, MARKED_X : MARKED_Y + 1] = self._start_px
        self.fits[:, AGREEMENT] = 1.0
        self.outline_px = np.column_stack([self._radius_px, np.zeros((count, 2))])
        self.pending, self.answered = np.zeros((2, count + 1), np.int64)
        self.times_us = NEVER_US, NEVER_US
        pixels, states = self.map.pixels, (self.motion, self.fits, self.outline_px)
        markers = self.pending, self.answered, self._radius_px, self._due, pixels
        self._fixed = *self.window, *states, *markers
        pixels["around"] = count
        for m in range(count):
            mark_kernel(pixels, m, *states, self.window.edge)
        self.area_px = np.bincount(pixels["around"].ravel(), minlength=count + 1)

    @property
    def heard(self) -> NDArray[np.int64]:
        """``(m + 1,)`` events around each marker so far, and those around none."""
        return self.answered + self.pending % AT_ONCE

    def place(self, marker: NDArray[np.bool_], position_px: NDArray[np.float64]) -> None:
        """Put markers somewhere at rest, after they were found again or predicted."""
        self.motion[marker, X:VX] = position_px[marker]
        self.motion[marker, VX : VX + 2] = 0.0
        self.pending[:-1][marker] |= AT_ONCE

    def absorb(self, packet: EventPacket, watch: HotPixelWatch) -> None:
        """Bring the map up to date, and count the events by marker, but for those of hot pixels.

        Raises:
            ConfigError: The packet comes from a sensor of another size.
        """
        levels = self.map
        settings = levels.dark_markers, levels.ahead, levels.events_kept
        maps = levels.pixels, levels.padded, *settings, self.pending
        for part in watch.parts(packet):
            absorb_discs_kernel(part.x, part.y, part.p, *maps)

    def locate(self, t_us: int, coasted: NDArray[np.bool_]) -> None:
        """Bring the motion of every marker that asks for it up to ``t_us``.

        Args:
            t_us: The time, us.
            coasted: ``(m,)`` markers that are held: their motion stays.
        """
        times_us = self.times_us = self.times_us[1], t_us
        maps = self.map.padded.ravel(), self._scratch, self._bands
        locate_discs_kernel(*maps, *self._fixed, coasted, times_us)


@kernel()
def absorb_discs_kernel(
    x: Array, y: Array, p: Array, pixels: Array, padded: Array, dark_markers: bool, ahead: float,
    kept: float, pending: Array,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Add each event to the map, and count it for the marker around it.

    Arguments are plain, since a tuple costs time: columns of the events; the map's pixels, its
    levels with their margin, and its settings; events around the markers.
    """
    for i in range(x.size):
        # Unsigned, so that no index can be meant from the end.
        row, column = np.uint64(y[i]), np.uint64(x[i])
        pixel = pixels[row, column]
        if heard_kernel(pixel):
            shown = integrate_event_kernel(pixel, p[i] != dark_markers, ahead, kept)
            padded[row + np.uint64(PAD_PX), column + np.uint64(PAD_PX)] = shown
            pending[pixel.around] += 1


@kernel()
def locate_discs_kernel(
    flat: Array, scratch: Array, bands: bool, offset: Array, around: Array, within: Array,
    coefficients: Array, edge: Array, motions: Array, fits: Array, outline_px: Array,
    pending: Array, answered: Array, radius_px: Array, due: Array, pixels: Array, coasted: Array,
    times_us: tuple[int, int],
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Fit the markers that enough events ask for, bring the filters up to the present.

    Arguments are plain, since a tuple costs a microsecond: the flat map with its margin, scratch
    for fits, and whether they are to dead bands; the fields of a :class:`FitWindow`; motions, fits,
    outlines, pending events and those before; radii at rest, px; events that ask for a fit; the
    map's pixels; who is held; when the last estimate was made and when this one is, us.
    """
    levels, t_us = (flat, pixels.shape[1], pixels.shape[0]), times_us[1]
    window = FitWindow(offset, around, within, coefficients, edge)
    for m in range(len(fits)):
        if motions[m, AT_US] == NEVER_US:
            fits[m, FIT_US] = fits[m, SILENT_US] = fits[m, OUTLINED_US] = motions[m, AT_US] = t_us
        dt_s = (t_us - motions[m, AT_US]) * 1e-6
        asked = asks_kernel(m, fits, pending, due, bands, times_us)
        if not asked and (pending[m] > 0 or dt_s < MEASUREMENT_PERIOD_S):
            continue
        motions[m, AT_US] = t_us
        if not asked and abs(motions[m, VX]) + abs(motions[m, VY]) < STILL_PX_S:
            continue
        predict_kernel(motions[m], dt_s)
        if asked:
            gain, since_us = 0.0, t_us - fits[m, OUTLINED_US]
            if since_us >= OUTLINE_US:
                gain, fits[m, OUTLINED_US] = 1.0 - np.exp(-1e-6 * OUTLINE_PER_S * since_us), t_us
            place = m, (motions[m, X], motions[m, Y]), outline_px, (ITERATIONS, gain, radius_px[m])
            if bands:
                x, y, agreement, step_px = fit_bands_kernel(pixels, levels, scratch, window, *place)
            else:
                x, y, agreement, step_px = fit_disc_kernel(levels, scratch, window, *place)
            fits[m, OFF_PX] = np.hypot(x - motions[m, X], y - motions[m, Y])
            fits[m, FIT_X], fits[m, FIT_Y], fits[m, FIT_US] = x, y, t_us
            fits[m, AGREEMENT] = agreement if gain > 0.0 else fits[m, AGREEMENT]
            answered[m] += pending[m] % AT_ONCE
            pending[m] = AT_ONCE if step_px >= LINEAR_STEP_PX else 0
        if coasted[m]:
            motions[m, VX] = motions[m, VY] = 0.0
        else:
            correct_kernel(motions[m], fits[m, FIT_X], fits[m, FIT_Y], dt_s)
        went_x, went_y = motions[m, X] - fits[m, MARKED_X], motions[m, Y] - fits[m, MARKED_Y]
        if max(abs(went_x), abs(went_y)) > MARKED_PX:
            mark_kernel(pixels, m, motions, fits, outline_px, edge)
