"""Slip on the twin, from events: contacts, frictions and a body that were not learned."""

from __future__ import annotations

from typing import Any

import numpy as np

from spikingtac.errors import ConfigError
from spikingtac.touch import SlipMonitor
from spikingtac_paper.touch.bodies import TESTED
from spikingtac_paper.touch.slides import CARRY, HOLD, LIFT_S, Slide, draw_slide
from spikingtac_paper.touch.slip_scores import METRICS as METRICS
from spikingtac_paper.touch.slip_scores import Truth, slip_scores
from spikingtac_paper.touch.watched_slides import WatchedSlide, watch_slide

METHODS = {
    "slip": "the share of the contact that sticks, from the shape of the field",
    "shift-stops": "gross slip where the mean shift of the markers stops growing",
}
FRICTIONS = (0.3, 0.45, 0.6, 0.75, 0.9)
CONTACTS, QUICK_CONTACTS = 60, 12
HELD_CONTACTS, QUICK_HELD_CONTACTS = 60, 2
"""Contacts that are held: false alarms are counted over their minutes."""
HELD_KINDS = (CARRY, CARRY, HOLD)
"""What is done with them, in turns."""
HELD_SEED = 5_000
"""Generator's seed of the first of them, from that of the other contacts on. So the held bodies of
a seed have the bodies and frictions of the contacts five seeds later, under another motion."""
SLOW_MM_S = 20.0
TAUGHT_SEED = 20_000
"""Generators' seeds from here on are those of contacts that the model was fitted to."""
SEED_STRIDE = 1_000
"""Generators' seeds from one seed of the experiment to the next."""
SEEDS = range((TAUGHT_SEED - HELD_SEED) // SEED_STRIDE)
"""Seeds whose contacts the model was not fitted to."""
STOP_SHARE = 0.2
"""Share of its fastest growth below which a shift has stopped (ours)."""
STOP_SPAN = 20
"""Frames over which growth is taken: 20 ms (ours)."""
LEAST_GROWTH_PX = 0.1
"""Growth of the mean shift in that time above which the skin moves, px (ours: five times its
error)."""
FALSE_ALARMS = (
    "false_incipient",
    "false_incipient_sticking",
    "false_gross",
    "false_gross_sticking",
    "sticking_s",
)
"""Scores of a contact that is held."""
NO_KIND_OF_SLIDE = ("stick", "short-rub", "roll")
"""Kinds in which a body does not slide as a whole for long; only false alarms count there."""


def require_seeds(seeds: range) -> None:
    """Raise ConfigError where the model was fitted to the contacts of a seed, or it has none."""
    if seeds.start not in SEEDS or seeds[-1] not in SEEDS:
        raise ConfigError(
            f"seeds {seeds.start} to {seeds[-1]} are given; slip is scored with {SEEDS.start} to "
            f"{SEEDS[-1]}, beyond lie the contacts that it was learned from: give --seed and "
            f"--seeds within, or leave out the methods {' and '.join(METHODS)}"
        )


def slip_records(methods: list[str], seed: int, quick: bool) -> list[dict[str, Any]]:
    """Return the scores of every method on every contact."""
    records = held_records(methods, seed, quick)
    for number in range(QUICK_CONTACTS if quick else CONTACTS):
        own = seed * SEED_STRIDE + number
        slide = draw_slide(np.random.default_rng(own), TESTED, FRICTIONS)
        watched = watch_slide(slide, own)
        truth = truth_of(watched)
        speed = "slow" if truth.slow else "fast"
        groups = ["slip/all", f"slip/{speed}", f"slip/{slide.body}"]
        for method in methods:
            incipient, gross = alarms_of(method, watched)
            scores = slip_scores(truth, incipient, gross)
            if slide.kind in NO_KIND_OF_SLIDE:
                scores = {k: v for k, v in scores.items() if not k.startswith(("gross", "lead"))}
            if method == "shift-stops":
                scores.pop("lead_20ms", None)
            trial = {"case": f"slip/{slide.kind}", "groups": groups, "seed": seed, "source": "twin"}
            records.append({"method": method, "trial": trial, "scores": scores})
    return records


def held_records(methods: list[str], seed: int, quick: bool) -> list[dict[str, Any]]:
    """Return the false alarms of every method on bodies that are carried and held."""
    records = []
    for number in range(QUICK_HELD_CONTACTS if quick else HELD_CONTACTS):
        own = HELD_SEED + seed * SEED_STRIDE + number
        kinds = (HELD_KINDS[number % len(HELD_KINDS)],)
        slide = draw_slide(np.random.default_rng(own), TESTED, FRICTIONS, kinds)
        watched = watch_slide(slide, own)
        for method in methods:
            scores = slip_scores(held_truth_of(watched), *alarms_of(method, watched))
            scores = {name: scores[name] for name in FALSE_ALARMS}
            trial = {"case": f"held/{slide.kind}", "groups": ["held/all"], "seed": seed}
            records.append(
                {"method": method, "trial": trial | {"source": "twin"}, "scores": scores}
            )
    return records


def truth_of(watched: WatchedSlide) -> Truth:
    """Return the truth of a contact up to its release, in which it slips whatever it does."""
    judged = watched.judged & watched.touching & (watched.t_us < _released_us(watched))
    return Truth(watched.t_us, watched.share, judged, _slow(watched.slide))


def held_truth_of(watched: WatchedSlide) -> Truth:
    """Return the truth of a contact that is held: alarms are judged while it stands, too."""
    there = watched.touching & np.isfinite(watched.share)
    judged = there & (watched.t_us < _released_us(watched))
    return Truth(watched.t_us, watched.share, judged, slow=False)


def _released_us(watched: WatchedSlide) -> int:
    return int(watched.t_us[-1]) - round(1e6 * (watched.slide.scene.lead_out_s + LIFT_S))


def _slow(slide: Slide) -> bool:
    return slide.speed_mm_s < SLOW_MM_S


def alarms_of(method: str, watched: WatchedSlide) -> tuple[list[int], list[int]]:
    """Return the times, us, at which a method reports incipient and gross slips."""
    if method == "shift-stops":
        return [], shift_stops(watched)
    monitor, slips = SlipMonitor(watched.reference_px), []
    frames = zip(watched.t_us.tolist(), watched.moved_px, watched.touching, strict=True)
    for t_us, moved, touching in frames:
        slips.append(monitor.update(t_us, moved, bool(touching)))
    slips.append(monitor.finish(int(watched.t_us[-1])))
    told = [slip for slip in slips if slip is not None]
    incipient = [slip.incipient_us for slip in told if slip.incipient_us is not None]
    return incipient, [slip.gross_us for slip in told if slip.gross_us is not None]


def shift_stops(watched: WatchedSlide) -> list[int]:
    """Return when the mean shift of the markers stops growing, us: the simpler way."""
    shift = np.sqrt((watched.moved_px.mean(axis=1) ** 2).sum(axis=1))
    growth = np.zeros(len(shift))
    growth[STOP_SPAN:] = shift[STOP_SPAN:] - shift[:-STOP_SPAN]
    fastest, stood, found = 0.0, True, []
    for row in np.flatnonzero(watched.touching).tolist():
        now = float(growth[row])
        stood = stood or now < LEAST_GROWTH_PX
        if stood and now > LEAST_GROWTH_PX:
            fastest = max(fastest, now)
        if fastest > 0.0 and now < STOP_SHARE * fastest:
            found.append(int(watched.t_us[row]))
            fastest, stood = 0.0, False
    return found
