"""Which pixels a marker covers when a recording begins: a map should not begin dark everywhere.

Events tell changes. Where a pixel swings from ground to marker, clipping tells its level, however
the map began. A disc that moves by less than its diameter leaves a part of itself where it is:
those pixels are bright all the time and send no event, so that a map that begins dark shows a
crescent, and no disc (docs/explanation/real-gels.md). They are enclosed by pixels that fire, of
which some begin bright: those that the disc leaves. (Around ground that moving discs enclose all
of them begin dark.) Beside them are pixels that swing a little, and darken first. Where a pixel
swings fully, clipping tells how it began, whatever was assumed. Ours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.calibration.buffered_events import BufferedEvents
from spikingtac.markers.calibration.finding.level_maps import MeanSteps, undo_kernel
from spikingtac.markers.calibration.finding.rest import moving_events

SMOOTH_PX = 1.0
"""Width of the Gaussian over which events of motion are counted: single pixels are noisy."""

FEWEST_EVENTS, OVER_NOISE = 1.0, 3.0
"""A pixel fires where so many events of motion were counted, and so many times the noise of that
time, which the rests tell."""

UNDECIDED = 0.5
"""Difference between a map that began dark and one that began bright from which the events do not
tell the level: less is left where a pixel swung over more than half."""

GROWN_PX = 5
"""How far beside silent pixels those that swing a little are covered, too (ours, on four sensors: 5
and 8 are alike; with 3 a gap stays inside of large discs, without a bound feet of edges count)."""

RIM_PX = 6
"""Width of the rim around silent pixels that tells whose they are."""

LEAST_LIT = 0.1
"""Share of that rim, where events tell how it began, that begins bright where a marker covers the
silent pixels (ours)."""


def starting_levels(
    events: BufferedEvents, rests_us: NDArray[np.int64], steps: MeanSteps
) -> NDArray[np.float32]:
    """Return ``(height, width)`` levels when the recording begins: 0 (ground) or 1 (marker).

    Args:
        events: The recording, markers brighter than the ground.
        rests_us: ``(rests, 2)`` when the skin rested, us since the start.
        steps: What an event stands for on the average.
    """
    # A late import: every verb's start would wait for it.
    from scipy import ndimage

    code = events.code[moving_events(events, rests_us)]
    sent = np.bincount(code >> 1, minlength=events.pixels).reshape(events.shape)
    smooth = ndimage.gaussian_filter(sent.astype(np.float32), SMOOTH_PX)
    fires = smooth > max(FEWEST_EVENTS, OVER_NOISE * _noise(events, len(code), rests_us))
    dark, bright = _first_levels(events, steps)
    undecided, lit = bright - dark > UNDECIDED, dark + bright > 1.0
    enclosed = np.asarray(ndimage.binary_fill_holes(fires), bool) & ~fires
    silent = np.zeros(events.shape, np.int32)
    ndimage.label(enclosed, output=silent)
    covered = np.zeros(events.shape, bool)
    for number, (rows, columns) in enumerate(ndimage.find_objects(silent), start=1):
        part = _widened(rows), _widened(columns)
        one = silent[part] == number
        near = np.asarray(ndimage.binary_dilation(one, iterations=RIM_PX), bool)
        rim = near & (fires & ~undecided)[part]
        covered[part] |= one & (
            np.count_nonzero(lit[part][rim]) > LEAST_LIT * np.count_nonzero(rim)
        )
    around = covered | (fires & undecided & _darkening(events, code, steps))
    grown = ndimage.binary_dilation(covered, iterations=GROWN_PX, mask=around)
    return grown.astype(np.float32)


def _widened(span: slice) -> slice:
    """Return the rows or columns of some pixels and of the rim around them."""
    return slice(max(span.start - RIM_PX, 0), span.stop + RIM_PX)


def _noise(events: BufferedEvents, moving: int, rests_us: NDArray[np.int64]) -> float:
    """Return the events of noise that a pixel sends while the skin moves, from its rests."""
    silence_us = float(np.diff(rests_us, axis=1).sum())
    per_us = (len(events) - moving) / max(silence_us, 1.0) / events.pixels
    return per_us * max(events.duration_us - silence_us, 0.0)


def _first_levels(
    events: BufferedEvents, steps: MeanSteps
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the levels when the recording begins, of a map that ended dark, and of a bright one.

    They differ where a pixel never swings.
    """
    dark, bright = np.zeros(events.pixels, np.float32), np.ones(events.pixels, np.float32)
    both = np.array([steps.on, steps.off], np.float32)
    for level in dark, bright:
        undo_kernel(level, events.code, both)
    return dark.reshape(events.shape), bright.reshape(events.shape)


def _darkening(
    events: BufferedEvents, code: NDArray[np.uint32], steps: MeanSteps
) -> NDArray[np.bool_]:
    """Return where pixels darken at their first event of motion rather than brighten."""
    from scipy.ndimage import gaussian_filter

    pixel, first = np.unique(code >> 1, return_index=True)
    fell = np.zeros(events.pixels, np.float32)
    fell[pixel] = np.where(code[first] & 1, -steps.on, steps.off)
    return gaussian_filter(fell.reshape(events.shape), SMOOTH_PX) > 0.0
