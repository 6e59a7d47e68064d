"""First model of a recording: tracked positions of the markers, and the steps of their events.

The tracker begins with a marker's own steps where these are larger than the mean. With the mean
steps, a paler marker would never be erased from the map where it was, and would seem to rest.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import Discs, nearest_marker
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.calibration.find_markers import Evidence, Overview
from spikingtac.markers.calibration.ideal_pixels import Model, compare
from spikingtac.markers.calibration.level_maps import SwingHistogram
from spikingtac.markers.calibration.recording import coded, noise_rates, times_at
from spikingtac.markers.crossings import followed
from spikingtac.types import EventPacket, FloatArray

# Initial edge width and contrast of the refinement.
FIRST_EDGE_PX, FIRST_CONTRAST = 0.8, 3.3

# What smoothing adds to the radius of a spot, px (0.4 to 0.7 on twelve sensors with discs of 3.2 to
# 25 px). A share of the radius would lose large discs: their rims would lie beyond each other.
SPOT_GROWTH_PX = 0.5

# Contrast threshold of a camera at usual settings, log intensity. Events determine only the product
# of steps and contrast, so this sets the scale of ``contrast``; a wrong value shifts radii by some
# 0.1 px (measured).
THRESHOLD = 0.25

# Rests and busy pixels that the event loss is measured from, and events of either polarity, alone
# and over those of noise, that make a pixel busy.
LOSS_RESTS, LOSS_PIXELS, BUSY_EVENTS, BUSY_OVER_NOISE = 6, 1_000, 10.0, 4.0

# Loss below which no events count as lost (four recordings, also with noise of 1 Hz/px or a dead
# time of 5 ms: -0.02 to 0.02; 0.27 to 0.29 without 30 % of the events, 0.43 to 0.49 without half).
# More than MOST_LOSS is not believed.
LEAST_LOSS, MOST_LOSS = 0.1, 0.8

# Bounds of the contrast that is derived from the steps.
CONTRASTS = (1.3, 12.0)

# Mean motion of the markers between two samples, px. (0.2 px is no better on simulated presses, and
# takes half as long again.)
SAMPLE_PX = 0.5

# Bounds of the number of samples: short recordings are sampled more finely, long ones more
# coarsely.
FEWEST_SAMPLES, MOST_SAMPLES = 400, 6_000

# Number of fits (samples times markers) above which short recordings are not sampled more finely.
# (For 1,024 markers, 160 samples are as good as 400.)
FEWEST_FITS = 160_000

# Most states that are compared, and most pixels of all states: each takes some 40 bytes.
MOST_STATES, MOST_STATE_PIXELS = 80, 12_000_000

REST_SHARE = 0.8  # Share of a rest after which it is sampled: at first the skin creeps.

# Prior weights, in full swings: of the neighbours' counts for each marker, and of its marker's
# counts for each pixel. (Light and lens change slowly over the skin: with the sensor's mean as the
# prior two random press sensors err by 9 and 4 % more.)
NEIGHBOUR_SWINGS, PIXEL_SWINGS = 10.0, 3.0

FEWEST_SWINGS = 50.0  # Swings, of a marker or in all, below which the mean steps are used.

FEWEST_EVENTS = 0.3  # Lower bound of the mean count of a full swing.

LEAST_RADIUS_PX = 0.5  # Of a disc that is tracked: a smaller one covers no pixel, px.

STEP_BOUNDS = (0.01, 1.0)  # Least and largest step, shares of a full swing.


def first_model(view: Overview) -> tuple[Evidence, Model]:
    """Return the evidence of a recording, and an initial model of it."""
    events, rest_px = view.events, view.markers.center_px
    (index, rests), markers = choose_samples(view), len(rest_px)
    brighter = 1.0 if view.polarity == "white" else -1.0  # Exponent of a disc's contrast.
    looks = FIRST_CONTRAST**brighter, FIRST_EDGE_PX, view.markers.radius_px - SPOT_GROWTH_PX
    discs = Discs(*(np.full(markers, value) for value in looks))
    cell = nearest_marker(rest_px, events.size).ravel()
    noise_hz_px = noise_rates(events, view.rests_us)
    states = choose_states(len(index), rests, events.pixels)
    loss = event_loss(events, index[rests[view.unloaded]], noise_hz_px)
    evidence = Evidence(events, index, states, rests, cell, noise_hz_px, loss)
    on_per_off, swings = float(view.steps[1] / view.steps[0]), SwingHistogram(cell)
    swings.absorb(coded(events), on_per_off)
    own, many = swings.steps(on_per_off), swings.counts.sum(axis=1) > FEWEST_SWINGS
    # Never smaller: a marker that hardly moves shows only noise and partial swings.
    steps = np.maximum(np.where(many, own, 0.0), view.steps[:, np.newaxis])
    model = Model(
        center_px=np.tile(rest_px, (len(index), 1, 1)),
        stretch_px=np.zeros((len(index), markers, 3)),
        discs=discs,
        steps=steps.clip(*STEP_BOUNDS),
        pixel=np.ones((2, events.pixels)),
        residual=np.zeros(markers),
    )
    model = with_steps(evidence, tracked(view, index, model, rest_px), rest_px)
    # Where events are lost, a step stands for more than one threshold.
    contrast = np.exp(THRESHOLD / (1.0 - loss) / np.sqrt(model.steps.prod(axis=0))).clip(*CONTRASTS)
    return evidence, replace(model, discs=replace(discs, contrast=contrast**brighter))


def event_loss(events: EventPacket, index: NDArray[np.int64], noise_hz_px: FloatArray) -> float:
    """Return the share of the events that was lost, measured by the balance of ON and OFF events.

    Between two rests of the skin brightness returns, and ON and OFF events balance but for an event
    or two of hysteresis. Lost events make the balance a random walk, whose variance grows by the
    lost share of the events. The ratio of a pixel's steps, taken from all of its events, ties both
    ends of the walk (a Brownian bridge): over k of n intervals the variance is k (1 - k / n) times
    that of a free step. The difference of k = 2 and k = 1, in which hysteresis cancels, is
    1 - 3 / n times.

    Args:
        events: The recording.
        index: Events before each rest without load.
        noise_hz_px: ``(2,)`` rates of ON and OFF noise.
    """
    if len(index) < LOSS_RESTS:
        return 0.0
    slots, code = 2 * events.pixels, coded(events)  # for OFF and ON events
    total = np.bincount(code[index[0] : index[-1]], minlength=slots).reshape(-1, 2)
    noise = noise_hz_px[::-1] * 1e-6 * np.diff(times_at(events, index[[0, -1]]))
    busy = (total >= np.maximum(BUSY_EVENTS, BUSY_OVER_NOISE * noise)).all(axis=1)
    if np.count_nonzero(busy) < LOSS_PIXELS:
        return 0.0
    ratio = total[busy, 1] / total[busy, 0]
    counts = np.array(
        [np.bincount(code[a:b], minlength=slots).reshape(-1, 2)[busy] for a, b in pairwise(index)]
    )
    walk = counts[..., 1] - ratio * counts[..., 0]
    one_interval, two = np.mean(walk**2), np.mean((walk[1:] + walk[:-1]) ** 2)
    growth = len(walk) * (two - one_interval) / (1.0 - 3.0 / len(walk))
    # Variances of all events and of the noise, if each came by chance.
    of_events = np.mean(total[busy, 1] + ratio**2 * total[busy, 0])
    of_noise = np.mean(noise[1] + ratio**2 * noise[0])
    loss = float((growth - of_noise) / (of_events - of_noise))
    return min(loss, MOST_LOSS) if loss > LEAST_LOSS else 0.0


def choose_samples(view: Overview) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return ``(n,)`` the events before each sample, and ``(rests,)`` the samples of rests."""
    events, markers = view.events, len(view.markers.center_px)
    # The two rims of a disc that moves by a pixel sweep its diameter: one swing up, one down.
    diameter_px = 2.0 * view.markers.radius_px * markers
    events_per_px = diameter_px * float((1.0 / view.steps).sum())
    fewest = min(FEWEST_SAMPLES, FEWEST_FITS // markers)
    apart = min(int(SAMPLE_PX * events_per_px), len(events) // fewest)
    apart = max(apart, len(events) // MOST_SAMPLES, 1)
    begin_us, length_us = view.rests_us[:, 0], np.diff(view.rests_us, axis=1)[:, 0]
    rest = events.t.searchsorted((begin_us + REST_SHARE * length_us).astype(np.int64))
    index = np.unique([*range(0, len(events), apart), *rest.tolist(), len(events)])
    return index, np.searchsorted(index, rest)


def choose_states(samples: int, rests: NDArray[np.int64], pixels: int) -> NDArray[np.int64]:
    """Return the samples to compare: all rests, and evenly spaced samples between them."""
    most = max(min(MOST_STATES, MOST_STATE_PIXELS // pixels), len(rests) + 2)
    even = np.linspace(0, samples - 1, most - len(rests)).astype(np.int64)
    apart = np.abs(even[:, np.newaxis] - rests).min(axis=1)
    return np.unique(np.concatenate([even[apart > 0.5 * samples / most], rests]))


def tracked(view: Overview, index: NDArray[np.int64], model: Model, rest_px: FloatArray) -> Model:
    """Return a model with the tracked positions of the markers at each sample.

    Lost markers keep the positions of the model: a prediction for silent ones would be biased. So
    do places of a lattice that lie off the sensor.

    Args:
        view: The recording.
        index: Number of events before each sample.
        model: Appearance of the markers, and their positions so far.
        rest_px: ``(m, 2)`` rest positions, px.
    """
    radius_px = model.discs.radius_px.clip(LEAST_RADIUS_PX)
    reach_px = radius_px[:, np.newaxis]
    inside = (rest_px >= -reach_px) & (rest_px <= np.array(view.events.size) + reach_px)
    seen = inside.all(axis=1)
    known = Calibration(
        reference_px=rest_px[seen],
        grid=None,
        size=view.events.size,
        radius_px=radius_px[seen],
        polarity=view.polarity,
        marker_edge_px=model.discs.edge_px[seen],
        marker_contrast=model.discs.stated_contrast[seen],
        step_on=float(np.median(model.steps[0])),
        step_off=float(np.median(model.steps[1])),
        marker_step_on=model.steps[0, seen],
        marker_step_off=model.steps[1, seen],
        recovery_s=model.recovery_s or None,
    )
    packets, further = [], next(iter(view.recorded))
    for end_us in times_at(view.events, index).tolist():
        packet, further = further.split(end_us)
        packets.append(packet)
    center_px = model.center_px.copy()
    for place_px, frame in zip(center_px, followed(packets, known), strict=True):
        lost = frame.coasted[:, np.newaxis]
        place_px[seen] = np.where(lost, place_px[seen], frame.detected_px)
    return replace(model, center_px=center_px)


def with_steps(evidence: Evidence, model: Model, rest_px: FloatArray) -> Model:
    """Return a model with the steps of each marker and each pixel, from counts of full swings.

    With a and b the steps (shares of a full swing) of an ON and an OFF event, the mean counts of
    events in full swings satisfy

        1 = a (n_on + 1/2) + b / 2,    1 = b (n_off + 1/2) + a / 2,

    since the level at which the pixel fired last is uniform within a step before the swing begins
    (not so before a pixel's first swing). Counts are those of a swing of full height: most swings
    are a little lower.
    Events against the direction of a swing are subtracted in pairs: a marker that reverses over a
    pixel, or noise near a threshold, fires pairs of events that cancel. (If they counted, simulated
    presses that are calibrated from themselves would err by 0.23 px instead of 0.18.) With too few
    swings the steps stay.

    Args:
        evidence: The recording.
        model: Positions and appearance of the markers.
        rest_px: ``(m, 2)`` rest positions, px.
    """
    seen = compare(evidence, model)
    by_marker, by_pixel = seen.marker_swings, seen.swings
    events, number, _ = by_marker.sum(axis=0).T
    if number.min() < FEWEST_SWINGS:
        return model
    per_swing = events / number
    for swings in by_marker, by_pixel:  # by the steps that the counts tell, not by the model's
        swings[..., 0] -= per_swing / per_swing[::-1] * swings[..., 2]
    events = by_marker[..., 0].sum(axis=0)
    # The prior of each marker's counts is its neighbours' mean, by a Gaussian as wide as the pitch.
    apart = np.hypot(*(rest_px[:, np.newaxis] - rest_px[np.newaxis]).transpose(2, 0, 1))
    pitch = float(np.median(np.sort(apart, axis=1)[:, 1])) if len(rest_px) > 1 else 1.0
    near = np.tensordot(np.exp(-0.5 * (apart / pitch) ** 2), by_marker, 1)
    counts = _mean_counts(by_marker, _mean_counts(near, events / number, 1.0), NEIGHBOUR_SWINGS)
    single = _mean_counts(by_pixel, counts[evidence.cell], PIXEL_SWINGS)
    steps = steps_of_counts(counts.T)
    pixel = steps_of_counts(single.T) / steps[:, evidence.cell]
    return replace(model, steps=steps, pixel=pixel)


def _mean_counts(swings: FloatArray, prior: FloatArray, weight: float) -> FloatArray:
    # Mean events of a swing, with a prior that weighs as much as so many swings.
    return (swings[..., 0] + weight * prior) / (swings[..., 1] + weight)


def steps_of_counts(counts: NDArray[np.floating]) -> FloatArray:
    """Return ``(2, ...)`` ON and OFF steps for mean counts of events in full swings.

    Args:
        counts: ``(2, ...)`` mean ON events of a swing from ground to marker, and OFF events of the
            way back.

    Example:
        >>> on, off = steps_of_counts(np.array([6.0, 6.0]))
        >>> float(on.round(4))  # 1 / (6 + 1)
        0.1429
    """
    rises, falls = np.maximum(counts, FEWEST_EVENTS) + 0.5
    steps = np.array([falls - 0.5, rises - 0.5]) / (rises * falls - 0.25)
    return steps.clip(*STEP_BOUNDS)
