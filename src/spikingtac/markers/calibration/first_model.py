"""A first model of a recording: where the tracker sees the markers, and what an event stands for.

The tracker begins with steps of each marker's own where they are larger: of one that is paler than
the others, steps of their size would never erase what it left behind, and it would seem to stand
still.
"""

from dataclasses import replace
from itertools import pairwise, starmap

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import REACH_EDGES, Discs
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.calibration.find_markers import Overview
from spikingtac.markers.calibration.ideal_pixels import Evidence, Model, compare
from spikingtac.markers.calibration.level_maps import SwingHistogram
from spikingtac.markers.calibration.recording import noise_events
from spikingtac.markers.graded.appearance import nearest_marker
from spikingtac.markers.lag import followed

# Edge width and contrast from which the refinement begins.
FIRST_EDGE_PX, FIRST_CONTRAST = 0.8, 3.3

# Radius from which it begins, as a share of that of the spots, which the blur makes larger.
FIRST_RADIUS_SHARE = 0.95

# Contrast threshold of a camera at usual settings, log intensity. Only the product of steps and
# contrast can be learnt from events, so it sets the scale of ``contrast``; a wrong one shifts
# radii by some 0.1 px (measured).
THRESHOLD = 0.25

# Least and largest contrast that the steps may stand for.
CONTRASTS = (1.3, 12.0)

# Samples are so far apart that the markers move by this much between two, on the average. (0.2 px
# is no better on simulated presses, and takes half as long again.)
SAMPLE_PX = 0.5

# Bounds of the samples: short recordings are sampled more finely, long ones more coarsely.
FEWEST_SAMPLES, MOST_SAMPLES = 400, 6_000

# Short recordings of so many markers that this is exceeded are not sampled more finely. (Of 1,024
# markers, 160 samples are as good as 400.)
FEWEST_FITS = 160_000

# States that are compared, and their pixels together: each pixel of each takes some 40 bytes.
MOST_STATES, MOST_STATE_PIXELS = 80, 12_000_000

REST_SHARE = 0.8  # Where in a rest it is sampled: the skin creeps in its first part.

# Full swings at its neighbours' counts that each marker is given beforehand (light and lens change
# slowly over the skin: at the sensor's instead two random press sensors err by 9 and 4 % more), and
# at its marker's counts that each pixel is given.
NEIGHBOUR_SWINGS, PIXEL_SWINGS = 10.0, 3.0

FEWEST_SWINGS = 50.0  # Swings, of a marker or in all, below which the sensor's mean steps are kept.

FEWEST_EVENTS = 0.3  # Least mean count of a full swing: a rarer event tells nothing.

STEP_BOUNDS = (0.01, 1.0)  # Least and largest step, shares of a full swing.


def first_model(view: Overview) -> tuple[Evidence, Model]:
    """Return what a recording's model has to explain, and one to begin with."""
    events, markers = view.events, len(view.markers.center_px)
    index, rests = choose_samples(view)
    discs = Discs(
        np.full(markers, FIRST_RADIUS_SHARE * view.markers.radius_px),
        np.full(markers, FIRST_EDGE_PX),
        np.full(markers, FIRST_CONTRAST),
    )
    cell = nearest_marker(view.markers.center_px, events.size).ravel().astype(np.int64)
    reach_px = float(discs.radius_px[0]) + REACH_EDGES * FIRST_EDGE_PX
    noise = np.pi * reach_px**2 * noise_events(events, view.rests_us)
    states = choose_states(len(index), rests, events.pixels)
    evidence = Evidence(events, index, states, rests, cell, noise)
    on_per_off, swings = float(view.steps[1] / view.steps[0]), SwingHistogram(cell)
    swings.absorb(events.code, on_per_off)
    own, many = swings.steps(on_per_off), swings.counts.sum(axis=1) > FEWEST_SWINGS
    # Never smaller: of a marker that hardly moves, noise and partial swings are seen.
    steps = np.maximum(np.where(many, own, 0.0), view.steps[:, np.newaxis])
    on, off = steps.clip(*STEP_BOUNDS)
    model = Model(
        center_px=np.tile(view.markers.center_px, (len(index), 1, 1)),
        stretch_px=np.zeros((len(index), markers, 3)),
        discs=discs,
        on=on,
        off=off,
        pixel=np.ones((2, events.pixels)),
        residual=np.zeros(markers),
        events=np.zeros((markers, 4)),
        swings=np.zeros(markers),
    )
    rest_px = view.markers.center_px
    model = with_steps(evidence, tracked(view, index, model, rest_px), rest_px)
    contrast = np.exp(THRESHOLD / np.sqrt(model.on * model.off)).clip(*CONTRASTS)
    return evidence, replace(model, discs=replace(discs, contrast=contrast))


def choose_samples(view: Overview) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return how many events come before each sample, and which samples stand for rests.

    Returns:
        ``(n,)`` numbers of events, increasing, and ``(rests,)`` samples.
    """
    events, markers = view.events, len(view.markers.center_px)
    # Both rims of a disc that moves by a pixel sweep its diameter, one up and one down a swing.
    diameter_px = 2.0 * view.markers.radius_px * markers
    events_per_px = diameter_px * float((1.0 / view.steps).sum())
    fewest = min(FEWEST_SAMPLES, FEWEST_FITS // markers)
    apart = min(int(SAMPLE_PX * events_per_px), len(events) // fewest)
    apart = max(apart, len(events) // MOST_SAMPLES, 1)
    begin_us, length_us = view.rests_us[:, 0], np.diff(view.rests_us, axis=1)[:, 0]
    rest = events.index_at((begin_us + REST_SHARE * length_us).astype(np.int64))
    index = np.unique([*range(0, len(events), apart), *rest.tolist(), len(events)])
    return index, np.searchsorted(index, rest)


def choose_states(samples: int, rests: NDArray[np.int64], pixels: int) -> NDArray[np.int64]:
    """Return the samples to compare: those of the rests, and others evenly in between."""
    most = max(min(MOST_STATES, MOST_STATE_PIXELS // pixels), len(rests) + 2)
    even = np.linspace(0, samples - 1, most - len(rests)).astype(np.int64)
    apart = np.abs(even[:, np.newaxis] - rests).min(axis=1)
    return np.unique(np.concatenate([even[apart > 0.5 * samples / most], rests]))


def tracked(
    view: Overview, index: NDArray[np.int64], model: Model, rest_px: NDArray[np.float64]
) -> Model:
    """Return a model with the places at which the tracker sees the markers at each sample.

    Those that it holds keep the places of the model: what fell silent would draw them elsewhere.

    Args:
        view: The recording.
        index: How many events come before each sample.
        model: How the markers look, and where they were so far.
        rest_px: ``(m, 2)`` where they rest, px.
    """
    known = Calibration(
        reference_px=rest_px,
        grid=None,
        size=view.events.size,
        radius_px=model.discs.radius_px,
        marker_edge_px=model.discs.edge_px,
        marker_contrast=model.discs.contrast,
        step_on=float(np.median(model.on)),
        step_off=float(np.median(model.off)),
        marker_step_on=model.on,
        marker_step_off=model.off,
        recovery_s=model.recovery_s or None,
    )
    at_us = view.events.times_at(index).tolist()
    packets = starmap(view.events.packet, pairwise([0, *at_us]))
    places_px = [
        np.where(frame.coasted[:, np.newaxis], known_px, frame.detected_px)
        for known_px, frame in zip(model.center_px, followed(packets, known), strict=True)
    ]
    return replace(model, center_px=np.array(places_px))


def with_steps(evidence: Evidence, model: Model, rest_px: NDArray[np.float64]) -> Model:
    """Return a model with what one event of each marker and of each pixel stands for.

    With a and b the shares of a full swing that an ON and an OFF event stand for, the mean counts
    of full swings are

        1 = a (n_on + 1/2) + b / 2,    1 = b (n_off + 1/2) + a / 2,

    since the level at which the pixel fired last lies anywhere within a step before the swing
    begins. What falls back on the way up, and rises on the way down, is taken off: a marker that
    turns round over a pixel, or noise near a threshold, fires pairs of events that add up to
    nothing. Where too few swings are seen the steps stay.

    Args:
        evidence: The recording.
        model: Where the markers went, and how they look.
        rest_px: ``(m, 2)`` where they rest, px.
    """
    seen = compare(evidence, model)
    by_marker, by_pixel = seen.marker_swings.copy(), seen.swings.copy()
    model = replace(model, swings=by_marker[:, 1] + by_marker[:, 3])
    on, rises, off, falls = by_marker.sum(axis=0)[:4].tolist()
    if min(rises, falls) < FEWEST_SWINGS:
        return model
    on_per_off = (on / rises) / (off / falls)
    for swings in by_marker, by_pixel:
        swings[:, 0] -= on_per_off * swings[:, 4]
        swings[:, 2] -= swings[:, 5] / on_per_off
    on, _, off, _ = by_marker.sum(axis=0)[:4].tolist()
    # Each marker's counts are a little drawn to its neighbours', a Gaussian as wide as the pitch.
    apart = np.hypot(*(rest_px[:, np.newaxis] - rest_px[np.newaxis]).transpose(2, 0, 1))
    pitch = float(np.median(np.sort(apart, axis=1)[:, 1])) if len(rest_px) > 1 else 1.0
    near = np.exp(-0.5 * (apart / pitch) ** 2) @ by_marker
    counts, single = [], []
    for usual, column in ((on / rises, 0), (off / falls, 2)):
        expected = (near[:, column] + usual) / (near[:, column + 1] + 1.0)
        known, number = by_marker[:, column], by_marker[:, column + 1]
        counts.append((known + NEIGHBOUR_SWINGS * expected) / (number + NEIGHBOUR_SWINGS))
        own, number = by_pixel[:, column], by_pixel[:, column + 1]
        beforehand = PIXEL_SWINGS * counts[-1][evidence.cell]
        single.append((own + beforehand) / (number + PIXEL_SWINGS))
    steps = np.array(steps_of_counts(*counts))
    pixel = np.array(steps_of_counts(*single)) / steps[:, evidence.cell]
    return replace(model, on=steps[0], off=steps[1], pixel=pixel)


def steps_of_counts(
    on: NDArray[np.floating], off: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the ON and OFF steps that mean counts of full swings stand for.

    Args:
        on: Mean ON events of a swing from ground to marker, any shape.
        off: Mean OFF events of the way back, same shape.

    Example:
        >>> on, off = steps_of_counts(np.array([6.0]), np.array([6.0]))
        >>> float(on.round(4)[0])  # 1 / (6 + 1)
        0.1429
    """
    rises = np.maximum(on, FEWEST_EVENTS) + 0.5
    falls = np.maximum(off, FEWEST_EVENTS) + 0.5
    both = rises * falls - 0.25
    on_step = ((falls - 0.5) / both).clip(*STEP_BOUNDS)
    return on_step, ((rises - 0.5) / both).clip(*STEP_BOUNDS)
