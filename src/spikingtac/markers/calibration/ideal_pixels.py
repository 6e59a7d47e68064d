"""Simulation of ideal event pixels along the markers' paths, and comparison with the real pixels.

An ideal pixel follows the logarithm of a blurred disc, and fires when its level differs from the
level of its last event by a step. The initial level of the last event is unknown, so several
ideal pixels, spread evenly over the possible levels, are simulated for each real one. The levels of
the real events are compared with the mean of the ideal ones: unlike a fit to the image, this is
unbiased by partial swings without an event, and by steps that are large in one direction. Events of
full swings of the real pixels, from ground to marker or back, are counted.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import Discs, draw_kernel
from spikingtac.markers.calibration.find_markers import Evidence
from spikingtac.markers.calibration.recording import coded, times_at
from spikingtac.state_map.graded import Array
from spikingtac.types import FloatArray

PHASES = 4  # Ideal pixels per real one: their mean is exact to an eighth of a step.
STILL_LEVEL = 1e-4  # Smaller changes of the level are no motion.

# A pixel is ground below the first level and marker above the second; it swings between them.
GROUND_LEVEL, MARKER_LEVEL = 0.03, 0.95

SETTLE_SAMPLES = 3  # Samples after the end of a swing in which events still count for it.
# Shortest swing that is counted, s: a snap saturates the readout. (Without swings below 10 ms a
# simulated drag that ends in a snap is calibrated 0.13 px off, below 20 or 30 ms 0.09 px.)
SNAP_S = 0.02


@dataclass(frozen=True, slots=True)
class Model:
    """Generative model of the events: paths and shapes of the discs, and steps of the pixels.

    Attributes:
        center_px: ``(n, m, 2)`` position of each marker at each sample, px.
        stretch_px: ``(n, m, 3)`` stretch of each disc there, as defined by ``draw_kernel``, px.
        discs: Appearance of the markers.
        steps: ``(2, m)`` steps of each marker's ON and OFF events, shares of a full swing.
        pixel: ``(2, pixels)`` steps of a pixel's ON and OFF events relative to its marker's.
        residual: ``(m,)`` rms residual of the levels around each marker.
        recovery_s: Time constant with which pixels adapt to a darkening, s; 0: they do not.
    """

    center_px: FloatArray
    stretch_px: FloatArray
    discs: Discs
    steps: FloatArray
    pixel: FloatArray
    residual: FloatArray
    recovery_s: float = 0.0


# State of a pixel, real and ideal.
PIXEL = np.dtype(
    [
        # Its steps; the model's level and its time, s, when the level changed last; the levels at
        # which the ideal pixels fired last; the disc that covered it last, -1 for none.
        *((name, np.float32) for name in ("on", "off", "level")),
        ("changed_s", np.float64),
        ("fired", np.float32, PHASES),
        ("disc", np.int32),
        # OFF and ON events so far, of all ideal pixels and of the real one; the real ones at the
        # last sample at an end of a swing, and when the swing began.
        *((name, np.int32, 2) for name in ("expected", "sent", "last", "begun")),
        # The last end: 1 ground, 2 marker, 0 none yet, negative at the start; the time there, s;
        # when the swing began; samples since a swing reached it (-1: none did); how deep the pixel
        # went into each end, as a share of a full swing from the other one.
        *((name, np.int32) for name in ("end", "since")),
        *((name, np.float64) for name in ("end_s", "begun_s")),
        ("deepest", np.float32, 3),
    ],
    align=True,
)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Levels of real and ideal pixels at the states, and counts of events.

    Attributes:
        pixel: ``(p,)`` the pixels that a disc covers at any state.
        measured: ``(states, p)`` sum of the real events' steps since the start.
        expected: The mean sum of the ideal events' steps since the start.
        drawn: The level of the model's image.
        owner: The disc that covers each pixel, -1 for none.
        events: ``(2, 2, m)`` real events beyond the noise and expected events, ON and OFF, of the
            pixels that each marker covered last.
        swings: ``(pixels, 2, 3)`` full swings of every pixel, rises and falls: sum of the events,
            sum of the heights, and events against the swing.
        marker_swings: ``(m, 2, 3)`` the same sums for the marker that covered the pixel.
    """

    pixel: NDArray[np.int64]
    measured: NDArray[np.float32]
    expected: NDArray[np.float32]
    drawn: NDArray[np.float32]
    owner: NDArray[np.int32]
    events: FloatArray
    swings: FloatArray
    marker_swings: FloatArray


def compare(evidence: Evidence, model: Model) -> Comparison:
    """Simulate ideal pixels along a model's paths, and compare them with the real ones."""
    events, states, markers = evidence.events, evidence.states, len(model.residual)
    pixels = np.zeros(events.pixels, PIXEL)
    pixels["on"], pixels["off"] = model.steps[:, evidence.cell] * model.pixel
    pixels["disc"] = pixels["since"] = -1
    levels = np.zeros((3, len(states), events.pixels), np.float32)
    owner = np.zeros((len(states), events.pixels), np.int32)
    swings = np.zeros((events.pixels, 2, 3)), np.zeros((markers, 2, 3))
    near = np.zeros((5, markers + 1))
    at_s = 1e-6 * (times_at(events, evidence.index) - events.t_start_us)
    paths = evidence.index, at_s, model.center_px, model.stretch_px, states
    per_s = 1.0 / model.recovery_s if model.recovery_s > 0.0 else 0.0
    out = levels, owner, near, swings
    rates = per_s, evidence.noise_hz_px[::-1].copy()
    compare_kernel(coded(events), events.shape, paths, model.discs.looks, pixels, rates, out)
    levels[1] /= PHASES
    off, on, *expected_off_on, looked_s = near[:, :-1]
    signal = np.array([on, off]) - np.multiply.outer(evidence.noise_hz_px, looked_s)
    near = np.array([signal, np.divide(expected_off_on[::-1], PHASES)])
    pixel = np.flatnonzero((owner >= 0).any(axis=0))
    (measured, expected, drawn), owner = levels.take(pixel, axis=2), owner.take(pixel, axis=1)
    return Comparison(pixel, measured, expected, drawn, owner, near, *swings)


@njit(cache=True)
def begin_kernel(pixels: Any, image: Array, now_s: float) -> None:
    """Begin at an image, with the levels of the ideal pixels' last events spread over a step."""
    for q in range(len(pixels)):
        pixel, level = pixels[q], image[q]
        pixel.level, pixel.changed_s, pixel.end_s = level, now_s, now_s
        pixel.end = -2 if level > MARKER_LEVEL else -1 if level < GROUND_LEVEL else 0
        for phase in range(PHASES):
            share = np.float32((phase + 0.5) / PHASES)
            pixel.fired[phase] = level + pixel.off - (pixel.on + pixel.off) * share


@njit(cache=True)
def follow_levels_kernel(
    chosen: Array, image: Array, pixels: Any, near: Array, now_s: float, per_s: float
) -> None:
    """Advance ideal pixels to the levels of an image; ``per_s`` is the rate of recovery, 1/s."""
    since_s, kept = 0.0, np.float32(1.0)
    for q in chosen:
        pixel, level = pixels[q], image[q]
        if abs(level - pixel.level) <= STILL_LEVEL:
            continue
        middle = np.float32(0.5) * (level + pixel.level)
        if per_s > 0.0 and now_s - pixel.changed_s != since_s:  # most share their last change
            since_s = now_s - pixel.changed_s
            kept = np.float32(np.exp(-per_s * since_s))
        rises = falls = 0
        for phase in range(PHASES):
            last = pixel.fired[phase]
            if last > middle and kept < np.float32(1.0):
                last = middle + kept * (last - middle)
            while level > last + pixel.on:
                last += pixel.on
                rises += 1
            while level < last - pixel.off:
                last -= pixel.off
                falls += 1
            pixel.fired[phase] = last
        for on, events in enumerate((falls, rises)):
            pixel.expected[on] += events
            near[2 + on, pixel.disc] += events
        pixel.level, pixel.changed_s = level, now_s


@njit(cache=True)
def end_swings_kernel(
    chosen: Array, image: Array, owner: Array, pixels: Any, now_s: float, noise_hz: Array,
    swings: tuple[Array, Array],
) -> None:  # fmt: skip
    """Add completed full swings to the sums of pixels and markers, without OFF and ON noise.

    A pixel's first swing does not count: the level of its last event before it is not known.
    """
    for q in chosen:
        pixel, level, left = pixels[q], image[q], owner[q] < 0
        at = 2 if level > MARKER_LEVEL else 1 if level < GROUND_LEVEL else 0
        inside = level if at == 2 else np.float32(1.0) - level
        pixel.deepest[at] = max(inside, pixel.deepest[at]) if at == pixel.end else inside
        if pixel.since >= 0:
            pixel.since += 1
            if at != pixel.end or pixel.since >= SETTLE_SAMPLES or left:
                ended = (pixel.last, pixel.end_s) if at != pixel.end else (pixel.sent, now_s)
                on = 1 if pixel.end == 2 else 0
                until, noise = ended[0], (ended[1] - pixel.begun_s) * noise_hz
                for sums in (swings[0][q, 1 - on], swings[1][pixel.disc, 1 - on]):
                    sums[0] += until[on] - pixel.begun[on] - noise[on]
                    sums[1] += pixel.deepest[1] + pixel.deepest[2] - 1.0
                    sums[2] += until[1 - on] - pixel.begun[1 - on] - noise[1 - on]
                pixel.since = -1
        if at != 0 and at != -pixel.end:
            if at != pixel.end and pixel.end > 0 and now_s - pixel.end_s > SNAP_S:
                pixel.since = 0
                pixel.begun[:], pixel.begun_s = pixel.last, pixel.end_s
            pixel.end, pixel.end_s = at, now_s
            pixel.last[:] = pixel.sent


@njit(cache=True)
def compare_kernel(
    code: Array, shape: tuple[int, int], paths: tuple[Array, Array, Array, Array, Array],
    looks: tuple[Array, Array, Array], pixels: Any, rates: tuple[float, Array],
    out: tuple[Array, Array, Array, tuple[Array, Array]],
) -> None:  # fmt: skip
    """Step through the samples; fill the records of the pixels, and a :class:`Comparison`.

    ``code`` holds all events, ``shape`` is that of an image; ``paths`` holds the events before each
    sample, its time, s, places and stretches of the discs, and the states; ``rates`` those of
    recovery, 1/s, and of OFF and ON noise, Hz; ``out`` holds the levels; the owners; near each
    marker, and last near none, OFF and ON events, expected ones, and the time for which its pixels
    were looked at, s; and the swings by pixel and by marker.
    """
    (index, at_s, center_px, stretch_px, states), (levels, owners, near, swings) = paths, out
    per_s, noise_hz = rates
    image, owner = np.zeros(shape, np.float32), np.full(shape, -1, np.int32)
    now, whose, at, former, kept = image.ravel(), owner.ravel(), index[0], 0, 0
    chosen, drawn = np.empty(image.size, np.int64), np.empty(image.size, np.int64)
    for sample in range(len(index)):
        for one in code[at : index[sample]]:
            pixel, on = pixels[one >> 1], one & 1
            pixel.sent[on] += 1
            near[on, pixel.disc] += 1
        at, place = index[sample], (center_px[sample], stretch_px[sample])
        covered = draw_kernel(place, looks, (image, owner), chosen)
        left_s = at_s[-1] - at_s[sample]
        for q in chosen[:covered]:
            near[4, pixels[q].disc] -= left_s
            near[4, whose[q]] += left_s
            pixels[q].disc = whose[q]
        if sample == 0:
            begin_kernel(pixels, now, at_s[0])
        changed = covered
        for q in drawn[:former]:
            if whose[q] < 0:  # a disc has left it since the last sample
                chosen[changed] = q
                changed += 1
        follow_levels_kernel(chosen[:changed], now, pixels, near, at_s[sample], per_s)
        end_swings_kernel(chosen[:changed], now, whose, pixels, at_s[sample], noise_hz, swings)
        if kept < len(states) and states[kept] == sample:
            on, off = pixels["on"], pixels["off"]
            for row, events in enumerate((pixels["sent"], pixels["expected"])):
                levels[row, kept] = on * events[:, 1] - off * events[:, 0]
            levels[2, kept], owners[kept] = now, whose
            kept += 1
        drawn, chosen, former = chosen, drawn, covered
        for q in drawn[:former]:
            now[q], whose[q] = 0.0, -1
