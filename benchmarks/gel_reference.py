"""Standing places of a gel's markers from counts of events: a reference that is not the package's.

    python benchmarks/gel_reference.py shared/data/gel                  # both recordings
    python benchmarks/gel_reference.py shared/data/gel --only simulated --markers 8
    python benchmarks/gel_reference.py shared/data/gel -o places.npz

Between two bursts of events every marker stands still. Each marker is explained by itself, and all
of its events at once: where it stands before, between and after the bursts, its radius, edge and
contrast, and what an ON and an OFF event of its pixels stand for. Ideal pixels, which differ in
their thresholds and in what they saw before, look at the logarithm of a blurred disc that goes
straight from place to place, and fire when they have left their last level by a threshold. The
places at which they fire as often as the real ones, pixel by pixel, burst by burst, are the result.
Nothing of the package's calibration or trackers is used but the places near which to look.

Two things that real gels and sensors do are found beside it, and reported: in a burst a marker may
go beyond the place at which it ends up (a share of its way, common to all markers), and pixels
forget a share of a swing while nothing happens (for each e-fold of the time since the last burst).
On `sim_presses`, whose truth is known, both come out as nothing, and the places are compared with
the truth; on the recorded gel they are compared with the reference file's.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numba import njit
from scipy.stats import norm, qmc

from spikingtac.events.open import open_events
from spikingtac.types import EventPacket

COPIES, MISMATCH = 24, 0.12
"""Ideal pixels for each real one, and the deviation of their thresholds (a share)."""
STEPS, RETURN_STEPS = 12, 4
"""Steps of a marker on its way, and on its way back if it went too far."""
REACH_PX, OTHERS_PX = 13.0, 8.0
"""Pixels so near to a marker's own places are looked at, if no other marker comes so near."""
MOST_EVENTS = 20
"""A pixel that sends more than this in a burst flickers."""
BEFORE_US, AFTER_US = 50_000, 100_000
"""Events so long before and after a burst still belong to it."""
REST_US = 0.3e6
"""Time from which forgetting is counted."""
FIRST = np.array([5.0, 1.1, np.log(3.0), np.log(0.12), np.log(0.3)])
"""Radius, px; edge beyond the least one, px; contrast, ON and OFF threshold (logarithms)."""
LEAST_EDGE_PX = 0.2
DIFFERENCES = np.array([0.25, 0.15, 0.2, 0.08, 0.08])
PLACE_DIFFERENCE_PX, SHARE_DIFFERENCE = 0.25, 0.03
MOST_ROUNDS, SETTLED = 25, 1e-4
PRIORS = np.array([0.1, 0.0, 0.3, 0.0, 0.0])
"""Weight of the first guess of the shape, which the counts hardly tell; places have PLACE_PRIOR."""
PLACE_PRIOR = 0.02
SCOUTS = 8
"""Markers whose median tells how far bursts go too far, before all are fitted with that."""


@dataclass(frozen=True)
class Recording:
    """Events and what is known of the places.

    Attributes:
        counts: ``(bursts, 2, height, width)`` ON and OFF events of every pixel.
        rests_s: ``(bursts,)`` time since the burst before, s.
        known_px: ``(m, bursts + 1, 2)`` places to look near, and to compare with, px.
        name: What they are.
    """

    counts: np.ndarray
    rests_s: np.ndarray
    known_px: np.ndarray
    name: str


@dataclass(frozen=True)
class Marker:
    """What is explained, and from where the search begins.

    Attributes:
        x: ``(n,)`` columns of the pixels.
        y: ``(n,)`` their rows.
        roots: ``(bursts, 2, n)`` roots of the counts.
        start_px: ``(bursts + 1, 2)`` first guess of the places.
        forgetting: ``(bursts,)`` what the share forgotten is multiplied by before each burst.
        beyond: ``(bursts,)`` how far beyond its end each burst goes, a share of its way; None lets
            it be found.
    """

    x: np.ndarray
    y: np.ndarray
    roots: np.ndarray
    start_px: np.ndarray
    forgetting: np.ndarray
    beyond: np.ndarray | None


@dataclass(frozen=True)
class Explained:
    """Places ``(bursts + 1, 2)``, px; shares beyond; share forgotten; rms of the roots' errors."""

    place_px: np.ndarray
    beyond: np.ndarray
    forgotten: float
    rms: float


def ideal_copies() -> np.ndarray:
    """Return ``(copies, 3)`` phases, and factors of the ON and of the OFF threshold."""
    even = qmc.Sobol(3, seed=1).random_base2(5)[:COPIES]
    return np.column_stack([2.0 * even[:, 0] - 1.0, 1.0 + MISMATCH * norm.ppf(even[:, 1:])])


@njit(cache=True, fastmath=True)
def level(x, y, cx, cy, disc):  # pragma: no cover - compiled
    """Return the logarithm of a blurred disc at a pixel, shares of the full swing."""
    radius_px, edge_px, contrast = disc
    inside = (np.hypot(x - cx, y - cy) - radius_px) / edge_px * 2.0
    return np.log1p(contrast / (1.0 + np.exp(min(40.0, inside)))) / np.log1p(contrast)


@njit(cache=True, fastmath=True)
def fire(pixels, places, disc, thresholds, forgotten, beyond, copies, out):  # pragma: no cover
    """Count what ideal pixels send in each burst, ``out (bursts, 2, n)``."""
    count = copies.shape[0]
    on, off = thresholds
    out[:] = 0.0
    memory = np.empty(count)
    for i in range(pixels.shape[1]):
        x, y = pixels[0, i], pixels[1, i]
        now = level(x, y, places[0, 0], places[0, 1], disc)
        for k in range(count):
            memory[k] = now + copies[k, 0] * on
        for burst in range(len(beyond)):
            for k in range(count):
                memory[k] -= forgotten[burst] * now
            for step in range(1, STEPS + RETURN_STEPS + 1):
                far = 1.0 + beyond[burst]
                if step <= STEPS:
                    share = far * step / STEPS
                else:
                    share = far - beyond[burst] * (step - STEPS) / RETURN_STEPS
                cx = places[burst, 0] + share * (places[burst + 1, 0] - places[burst, 0])
                cy = places[burst, 1] + share * (places[burst + 1, 1] - places[burst, 1])
                now = level(x, y, cx, cy, disc)
                for k in range(count):
                    apart = now - memory[k]
                    rise, fall = on * copies[k, 1], off * copies[k, 2]
                    if apart > rise:
                        times = np.floor(apart / rise)
                        memory[k] += times * rise
                        out[burst, 0, i] += times / count
                    elif apart < -fall:
                        times = np.floor(-apart / fall)
                        memory[k] -= times * fall
                        out[burst, 1, i] += times / count


def explain(marker: Marker) -> Explained:
    """Find what makes the ideal pixels send what the real ones sent (Levenberg-Marquardt)."""
    bursts, free = len(marker.forgetting), marker.beyond is None
    places = 2 * (bursts + 1)
    expected, pixels = np.empty(marker.roots.shape), np.stack([marker.x, marker.y])
    copies = ideal_copies()
    first = np.concatenate([np.zeros(places), FIRST, [0.0], np.zeros(bursts if free else 0)])
    differences = np.concatenate([
        np.full(places, PLACE_DIFFERENCE_PX), DIFFERENCES,
        np.full(1 + (bursts if free else 0), SHARE_DIFFERENCE),
    ])  # fmt: skip
    weights = np.concatenate([np.full(places, PLACE_PRIOR), PRIORS])

    def errors(values: np.ndarray) -> np.ndarray:
        radius_px, edge_px, contrast, on, off = values[places : places + 5]
        beyond = values[places + 6 :] if free else marker.beyond
        fire(
            pixels,
            marker.start_px + values[:places].reshape(-1, 2),
            (radius_px, abs(edge_px) + LEAST_EDGE_PX, np.exp(contrast)),
            (np.exp(on), np.exp(off)),
            values[places + 5] * marker.forgetting,
            beyond,
            copies,
            expected,
        )
        prior = weights * (values - first)[: places + 5]
        return np.concatenate([(np.sqrt(expected + 0.375) - marker.roots).ravel(), prior])

    values, left = _least_squares(errors, first, differences)
    own = left[: marker.roots.size]
    beyond = values[places + 6 :] if marker.beyond is None else marker.beyond
    place_px = marker.start_px + values[:places].reshape(-1, 2)
    return Explained(place_px, beyond, float(values[places + 5]), float(np.sqrt((own**2).mean())))


def _least_squares(errors, values, differences):
    # Counts are no smooth function: slopes are taken over wide differences.
    left, damping = errors(values), 0.1
    for _ in range(MOST_ROUNDS):
        slopes = np.empty((left.size, values.size))
        for k, width in enumerate(differences):
            aside = np.zeros_like(values)
            aside[k] = width
            slopes[:, k] = (errors(values + aside) - errors(values - aside)) / (2.0 * width)
        curvature, pull = slopes.T @ slopes, slopes.T @ left
        before = left @ left
        for _ in range(6):
            damped = curvature + damping * np.diag(np.diag(curvature) + 1e-3)
            step = np.clip(-np.linalg.solve(damped, pull), -4.0 * differences, 4.0 * differences)
            tried = errors(values + step)
            if tried @ tried < before:
                break
            damping *= 4.0
        else:
            return values, left
        values, left, damping = values + step, tried, max(damping / 4.0, 1e-3)
        if before - left @ left < SETTLED * before:
            break
    return values, left


def marker_of(recording: Recording, index: int, beyond: np.ndarray | None) -> Marker:
    """Cut out one marker's pixels; the search begins half a pixel and more beside the known."""
    known = recording.known_px
    own, others = known[index], np.delete(known, index, axis=0).reshape(-1, 2)
    height, width = recording.counts.shape[2:]
    y, x = np.mgrid[:height, :width].reshape(2, -1).astype(float)
    near = np.hypot(x[:, None] - own[:, 0], y[:, None] - own[:, 1]).min(axis=1)
    far = np.hypot(x[:, None] - others[:, 0], y[:, None] - others[:, 1]).min(axis=1)
    kept = (near < REACH_PX) & (far > near) & (far > OTHERS_PX)
    counts = recording.counts[:, :, y[kept].astype(int), x[kept].astype(int)]
    middle = own[::2].mean(axis=0)
    rng = np.random.default_rng(index)
    start_px = middle + 0.85 * (own - middle) + rng.normal(0.0, 0.5, own.shape)
    forgetting = np.log1p(recording.rests_s * 1e6 / REST_US)
    roots = np.sqrt(counts.clip(0, MOST_EVENTS) + 0.375)
    return Marker(x[kept], y[kept], roots, start_px, forgetting, beyond)


def recorded(folder: Path) -> Recording:
    """Return the recorded gel, and the places of the reference file."""
    with np.load(folder / "real_presses.reference.npz") as known:
        bursts_us, places_px = known["burst_us"].astype(np.int64), known["plateau_px"]
    events = EventPacket.concatenate(list(open_events(folder / "real_presses.aedat4")))
    spans_us = bursts_us + np.array([-BEFORE_US, AFTER_US])
    return _recording(events, spans_us, places_px, "the reference file")


def simulated(folder: Path, contacts: int = 4) -> Recording:
    """Return the first contacts of the simulated gel, and its true places."""
    with np.load(folder / "sim_presses.truth.npz") as truth:
        t_us, places_px = truth["marker_t_us"], truth["marker_px"]
    events = EventPacket.concatenate(list(open_events(folder / "sim_presses.raw")))
    speed_px_s = 1e6 * np.linalg.norm(np.diff(places_px, axis=0), axis=2).max(axis=1)
    moving = np.flatnonzero(speed_px_s / np.diff(t_us) > 8.0)
    gaps = np.flatnonzero(np.diff(t_us[moving]) > 150_000)
    first = np.append(moving[0], moving[gaps + 1])
    last = np.append(moving[gaps], moving[-1])
    spans_us = np.column_stack([t_us[first] - 10_000, t_us[last] + 30_000])[: 2 * contacts]
    middle_us = (spans_us[:-1, 1] + spans_us[1:, 0]) // 2
    at = np.searchsorted(t_us, np.concatenate([[0], middle_us, [spans_us[-1, 1] + AFTER_US]]))
    return _recording(events, spans_us, places_px[at].transpose(1, 0, 2), "the truth")


def _recording(
    events: EventPacket, spans_us: np.ndarray, known_px: np.ndarray, name: str
) -> Recording:
    width, height = events.size
    counts = np.zeros((len(spans_us), 2, height, width))
    t_us = events.t - events.t[0]
    for k, (begin, end) in enumerate(spans_us):
        some = slice(*np.searchsorted(t_us, [begin, end]))
        polarity = 1 - events.p[some].astype(int)
        np.add.at(counts[k], (polarity, events.y[some], events.x[some]), 1)
    begins, ends = spans_us[:, 0], np.append(0, spans_us[:-1, 1])
    return Recording(counts, (begins - ends) * 1e-6, known_px, name)


def explain_all(recording: Recording, markers: Sequence[int], workers: int) -> list[Explained]:
    """Find how far bursts go too far from some markers, then explain all with that."""
    scouts = markers[:: max(1, len(markers) // SCOUTS)]
    with ProcessPoolExecutor(workers) as pool:
        make = partial(marker_of, recording)
        found = list(pool.map(explain, [make(k, None) for k in scouts]))
        beyond = np.median([one.beyond for one in found], axis=0)
        beyond[np.abs(beyond) < 1.5 * np.std([one.beyond for one in found], axis=0)] = 0.0
        straight = list(pool.map(explain, [make(k, np.zeros_like(beyond)) for k in markers]))
        if not beyond.any():
            return straight
        freely = list(pool.map(explain, [make(k, beyond) for k in markers]))
    better = np.mean([one.rms for one in freely]) < np.mean([one.rms for one in straight])
    print(f"  residual {rms(straight):.4f} straight, {rms(freely):.4f} with bursts that go too far")
    return freely if better else straight


def rms(found: Sequence[Explained]) -> float:
    """Return the root of the mean square over markers."""
    return float(np.sqrt(np.mean([one.rms**2 for one in found])))


def report(recording: Recording, markers: Sequence[int], found: Sequence[Explained]) -> None:
    """Print how far places and ways differ from the known ones, and whether rests close."""
    place_px = np.array([one.place_px for one in found])
    known_px = recording.known_px[list(markers)]
    ways, known_ways = np.diff(place_px, axis=1), np.diff(known_px, axis=1)
    off = np.linalg.norm(place_px - known_px, axis=2)
    print(
        f"  residual {rms(found):.4f}; beyond the end, share of the way: {found[0].beyond.round(2)}"
    )
    print(f"  forgotten, share of a swing: {np.median([one.forgotten for one in found]):.3f}")
    print(
        f"  places, difference to {recording.name}: {off.mean():.2f} px mean, {off.max():.1f} worst"
    )
    print(f"    each: {off.mean(axis=0).round(2)}")
    away = np.linalg.norm(ways - known_ways, axis=2)
    print(
        f"  ways from place to place: {away.mean():.2f} px mean; each: {away.mean(axis=0).round(2)}"
    )
    for name, places in (("found", place_px), (recording.name, known_px)):
        rests = places[:, ::2]
        apart = np.linalg.norm(rests - np.median(rests, axis=1, keepdims=True), axis=2)
        print(f"  rests differ from their median, {name}: {apart.mean(axis=0).round(2)} px")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="folder with the gel's recordings")
    parser.add_argument("--only", choices=("simulated", "recorded"))
    parser.add_argument("--markers", type=int, help="so many markers; all unless given")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("-o", "--output", type=Path, help="file for the recorded gel's places")
    given = parser.parse_args(arguments)
    for name, load in (("simulated", simulated), ("recorded", recorded)):
        if given.only not in (None, name):
            continue
        print(name)
        recording = load(given.folder)
        everyone = np.arange(len(recording.known_px))
        count = given.markers or len(everyone)
        markers = [int(k) for k in everyone[:: max(1, len(everyone) // count)]]
        found = explain_all(recording, markers, given.workers)
        report(recording, markers, found)
        if given.output is not None and name == "recorded":
            np.savez(given.output, marker=markers, place_px=[one.place_px for one in found])
    return 0


if __name__ == "__main__":
    sys.exit(main())
