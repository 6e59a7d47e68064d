"""Which pixels a marker covers when a recording begins: a map should not begin dark everywhere.

Events tell changes. Where a pixel swings from ground to marker, clipping tells its level, however
the map began. A disc that moves by less than its diameter leaves a part of itself where it is:
those pixels are bright all the time and send no event, so that a map that begins dark shows a
crescent, and no disc (docs/explanation/real-gels.md). They are enclosed by pixels that fire, of
which some darken first: those that the disc leaves. (Around ground that moving discs enclose all of
them brighten.) Beside them are pixels that swing a little, and darken first, too. Ours.
"""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.calibration.buffered_events import BufferedEvents
from spikingtac.markers.calibration.finding.level_maps import MeanSteps, add_kernel

SMOOTH_PX = 1.0
"""Width of the Gaussian over which events of motion are counted: single pixels are noisy."""

FEWEST_EVENTS, OVER_NOISE = 1.0, 3.0
"""A pixel fires where so many events of motion were counted, and so many times what the quiet
pixels send in noise."""

QUIET_PERCENT = 10.0
"""Pixels that are taken to be quiet: on dense skins moving discs pass most of the ground."""

UNDECIDED = 0.5
"""Difference between a map that began dark and one that began bright from which the events do not
tell the level: less is left where a pixel swung over more than half."""

GROWN_PX = 5
"""How far beside silent pixels those that swing a little are covered, too (ours, on four sensors: 5
and 8 are alike; with 3 a gap stays inside of large discs, without a bound feet of edges count)."""

RIM_PX = 4
"""Width of the rim around silent pixels that tells whose they are."""

LEAST_DARKENED = 0.2
"""Share of the first steps of light in that rim that darken it where a marker covers the silent
pixels (simulated, nine sensors: 0.25 to 1)."""


def starting_levels(
    events: BufferedEvents, moving: NDArray[np.bool_], steps: MeanSteps
) -> NDArray[np.float32]:
    """Return ``(height, width)`` levels when the recording begins: 0 (ground) or 1 (marker).

    Args:
        events: The recording, markers brighter than the ground.
        moving: ``bool[n]`` events that belong to motion.
        steps: What an event stands for on the average.
    """
    # A late import: every verb's start would wait for it.
    from scipy import ndimage

    code = events.code[moving]
    sent = np.bincount(code >> 1, minlength=events.pixels).reshape(events.shape)
    smooth = ndimage.gaussian_filter(sent.astype(np.float32), SMOOTH_PX)
    fires = smooth > max(FEWEST_EVENTS, OVER_NOISE * float(np.percentile(smooth, QUIET_PERCENT)))
    falls, rises = _first_steps(events, code, steps)
    enclosed = np.asarray(ndimage.binary_fill_holes(fires), bool) & ~fires
    silent = np.zeros(events.shape, np.int32)
    count = int(cast(int, ndimage.label(enclosed, output=silent)))
    covered = np.zeros(events.shape, bool)
    for number in range(1, count + 1):
        one = silent == number
        rim = ndimage.binary_dilation(one, iterations=RIM_PX) & ~one
        fell = falls[rim].sum()
        covered |= one & (fell > LEAST_DARKENED * (fell + rises[rim].sum()))
    darkening = ndimage.gaussian_filter(falls - rises, SMOOTH_PX) > 0.0
    around = covered | (fires & darkening & _undecided(events, steps))
    return ndimage.binary_dilation(covered, iterations=GROWN_PX, mask=around).astype(np.float32)


def _undecided(events: BufferedEvents, steps: MeanSteps) -> NDArray[np.bool_]:
    """Return which pixels end as they began: those that never swing."""
    dark, bright = np.zeros(events.pixels, np.float32), np.ones(events.pixels, np.float32)
    both = np.array([steps.on, steps.off], np.float32)
    for level in dark, bright:
        add_kernel(level, events.code, both)
    return (bright - dark > UNDECIDED).reshape(events.shape)


def _first_steps(
    events: BufferedEvents, code: NDArray[np.uint32], steps: MeanSteps
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return by how much each pixel's first event darkened and brightened it."""
    pixel, first = np.unique(code >> 1, return_index=True)
    on = (code[first] & 1).astype(bool)
    moved = np.zeros((2, events.pixels), np.float32)
    moved[0, pixel[~on]], moved[1, pixel[on]] = steps.off, steps.on
    return moved[0].reshape(events.shape), moved[1].reshape(events.shape)
