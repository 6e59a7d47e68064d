"""Slip on the twin, from events: contacts, frictions and a body that were not learned."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.sim import SceneSource, Timeline
from spikingtac.touch import SlipMonitor, TouchDetector
from spikingtac.types import US_PER_S, FloatArray
from spikingtac_paper.harness.report import Metric
from spikingtac_paper.touch.contacts import (
    CARRY,
    HOLD,
    KINDS,
    LIFT_S,
    RATE_HZ,
    TESTED,
    DrawnContact,
    draw_contact,
    record,
    watch,
)

Times = NDArray[np.int64]
Flags = NDArray[np.bool_]

FRICTIONS = (0.3, 0.45, 0.6, 0.75, 0.9)
CONTACTS, QUICK_CONTACTS = 60, 12

# Contacts that are held: false alarms are counted over their minutes.
HELD_CONTACTS, QUICK_HELD_CONTACTS = 60, 2
HELD_KINDS = (CARRY, CARRY, HOLD)  # What is done with them, in turns.

# Generator's seed of the first of them, from that of the other contacts on. So the held bodies of
# a seed have the bodies and frictions of the contacts five seeds later, under another motion.
HELD_SEED = 5_000

# Generators' seeds from here on are those of contacts that the model was fitted to.
TAUGHT_SEED = 20_000
SEED_STRIDE = 1_000  # Generators' seeds from one seed of the experiment to the next.

# Seeds whose contacts the model was not fitted to.
SEEDS = range((TAUGHT_SEED - HELD_SEED) // SEED_STRIDE)

# Kinds in which a body does not slide as a whole for long; only false alarms count there.
NO_KIND_OF_SLIDE = ("stick", "short-rub", "roll", CARRY, HOLD)
SLOW_MM_S = 20.0  # Speed below which an incipient slip must be told ahead of the gross one, mm/s.

STOP_SHARE = 0.2  # Share of its fastest growth below which a shift has stopped.
STOP_SPAN = 20  # Frames over which growth is taken: 20 ms.

# Growth of the mean shift in that time above which the skin moves, px (five times its
# error).
LEAST_GROWTH_PX = 0.1

LEAST_CELLS = 20  # Cells of the skin below which a share of them says little (3 mm2).
ARM_MM = 3.0  # Arm at which a turn counts as a motion, mm.
STILL_MM_S = 0.5  # Speed of the body below which it stands, mm/s.

# Sticking share below which a contact has slipped: what it carries while it stands is no longer
# told by what sticks.
SLIPPED_SHARE = 0.9

GROSS_SHARE = 0.05  # Sticking share below which the whole contact slips.

# Share from which on a gross slip may be noticed however early; before, it must come within 100
# ms.
EARLY_SHARE = 0.35
LATE_US = 10_000  # Delay up to which a gross slip is noticed in time, us.
LEAD_US = 20_000  # Time by which an incipient slip must come before the gross one, us.

# Share of a contact that holds: what was told before it held last announces nothing.
HELD_SHARE = 0.98
EARLIER_US = 100_000  # Time before that in which an alarm still belongs to this slip, us.

# An incipient slip is a false alarm where more sticks all the while: 20 ms before to 300 after.
STICKS_SHARE = 0.85

# A gross slip is a false alarm where more sticks all the while: 20 ms before to 100 after.
FALSE_GROSS_SHARE = 0.3
BEFORE_US, AFTER_INCIPIENT_US, AFTER_GROSS_US = 20_000, 300_000, 100_000

# Share from which a contact counts as sticking: false alarms per ten minutes are counted over it.
# What is told between the two shares is told of a contact that slips in part: early, if not
# right.
STICKING_SHARE = 0.9
US_PER_MS = 1e3

METHODS = {
    "slip": "the share of the contact that sticks, from the shape of the field",
    "shift-stops": "gross slip where the mean shift of the markers stops growing",
}
METRICS = (
    Metric("gross_in_time", "1", "share of first gross slips noticed until 10 ms after they begin"),
    Metric("gross_delay_ms", "ms", "delay of those noticed at all; negative is early"),
    Metric("lead_20ms", "1", "share of the slides below 20 mm/s told 20 ms before it"),
    Metric("false_incipient", "alarms", "incipient slips told while 85 % and more stick", "sum"),
    Metric("false_incipient_sticking", "alarms", "of these, told while 90 % and more stick", "sum"),
    Metric("false_gross", "alarms", "gross slips told while 30 % and more stick", "sum"),
    Metric("false_gross_sticking", "alarms", "of these, told while 90 % and more stick", "sum"),
    Metric("sticking_s", "s", "time in which contacts stuck", "sum"),
)


def require_seeds(seeds: range) -> None:
    """Raise ConfigError where the model was fitted to the contacts of a seed, or it has none."""
    if seeds.start not in SEEDS or seeds[-1] not in SEEDS:
        raise ConfigError(
            f"seeds {seeds.start} to {seeds[-1]} are given; slip is scored with {SEEDS.start} to "
            f"{SEEDS[-1]}, beyond lie the contacts that it was learned from: give --seed and "
            f"--seeds within, or leave out the methods {' and '.join(METHODS)}"
        )


@dataclass(frozen=True, slots=True)
class WatchedContact:
    """A drawn contact as camera and tracker see it, frame by frame.

    Attributes:
        contact: What was done.
        reference_px: ``(m, 2)`` markers at rest, px.
        t_us: ``(n,)`` times, us.
        moved_px: ``(n, m, 2)`` displacements from the rest before the touch, px, as slip sees them.
        touching: ``(n,)`` whether a touch was noticed.
        share: ``(n,)`` true share of the touching cells that stick; nan where few touch.
        judged: ``(n,)`` whether that share tells what the contact can still carry: the body moves,
            or it has never slipped.
    """

    contact: DrawnContact
    reference_px: FloatArray
    t_us: Times
    moved_px: FloatArray
    touching: Flags
    share: FloatArray
    judged: Flags


def watch_contact(contact: DrawnContact, seed: int) -> WatchedContact:
    """Return a contact seen by the camera ``typical`` and the tracker ``default``."""
    scene = contact.scene.with_camera("typical")
    source = SceneSource(scene, seed, mechanics_hz=contact.mechanics_hz)
    detector, frames = TouchDetector(source.reference_px), []
    truth: list[NDArray[np.int64]] = []

    def note(step: Any) -> None:
        told = step.truth
        cells = [np.bitwise_count(bits).sum(axis=1, dtype=np.int64)
                 for bits in (told.touching_cells, told.sticking_cells)]  # fmt: skip
        truth.append(np.column_stack([told.contact_t_us, *cells]))

    for frame in watch(source, note):
        detector.update(frame)
        frames.append((frame.t_us, detector.tracked_px, detector.touching))
    t_us, moved, touching = (np.array(column) for column in zip(*frames, strict=True))
    share = _share_at(t_us, np.concatenate(truth))
    has_share = np.isfinite(share)
    slipped = np.logical_or.accumulate(has_share & (np.nan_to_num(share) < SLIPPED_SHARE))
    judged = has_share & (_moving(contact, t_us) | ~slipped)
    return WatchedContact(contact, source.reference_px, t_us, moved, touching, share, judged)


def _share_at(t_us: Times, truth: Times) -> FloatArray:
    """Return the sticking share of the last true row at each time."""
    rows = np.maximum(np.searchsorted(truth[:, 0], t_us, side="right") - 1, 0)
    touching, sticking = truth[rows, 1], truth[rows, 2]
    return np.where(touching >= LEAST_CELLS, sticking / np.maximum(touching, 1), np.nan)


def _moving(contact: DrawnContact, t_us: Times) -> Flags:
    """Return whether the body moves or turns at each time."""
    timeline, step_s = Timeline(contact.scene, 0), 0.5 / RATE_HZ
    moving = np.zeros(len(t_us), np.bool_)
    for row, time_s in enumerate((t_us * 1e-6).tolist()):
        before, after = timeline.at(max(time_s - step_s, 0.0)), timeline.at(time_s + step_s)
        if before is None or after is None:
            continue
        shift = np.linalg.norm(after[1].position_mm - before[1].position_mm)
        turn = np.linalg.norm(after[1].rotation - before[1].rotation) / np.sqrt(2.0)
        moving[row] = shift + ARM_MM * turn > STILL_MM_S * 2.0 * step_s
    return moving


def slip_records(methods: list[str], seed: int, quick: bool) -> list[dict[str, Any]]:
    """Return the scores of every method on bodies that are held, and on every other contact."""
    held, free = (QUICK_HELD_CONTACTS, QUICK_CONTACTS) if quick else (HELD_CONTACTS, CONTACTS)
    first = seed * SEED_STRIDE
    drawn = [(HELD_SEED + first + k, (HELD_KINDS[k % len(HELD_KINDS)],)) for k in range(held)]
    drawn += [(first + k, KINDS) for k in range(free)]
    records = []
    for own, kinds in drawn:
        contact = draw_contact(np.random.default_rng(own), TESTED, FRICTIONS, kinds)
        records += _contact_records(methods, seed, watch_contact(contact, own))
    return records


def _contact_records(
    methods: list[str], seed: int, watched: WatchedContact
) -> Iterator[dict[str, Any]]:
    contact, truth = watched.contact, truth_of(watched)
    cases = [f"slip/{contact.kind}", "slip/all", f"slip/{'slow' if truth.slow else 'fast'}",
             f"slip/{contact.body}"]  # fmt: skip
    if contact.kind in HELD_KINDS:
        cases = [f"held/{contact.kind}", "held/all"]
    for method in methods:
        scores = slip_scores(truth, *alarms_of(method, watched))
        if contact.kind in NO_KIND_OF_SLIDE:
            scores = {k: v for k, v in scores.items() if not k.startswith(("gross", "lead"))}
        if method == "shift-stops":
            scores.pop("lead_20ms", None)
        yield record(method, cases, seed, scores)


@dataclass(frozen=True, slots=True)
class Truth:
    """What sticks, frame by frame.

    Attributes:
        t_us: ``(n,)`` times, us.
        share: ``(n,)`` share of the contact that sticks; nan where little touches.
        judged: ``(n,)`` frames in which alarms are judged.
        slow: Whether an incipient slip must be told 20 ms ahead.
    """

    t_us: Times
    share: FloatArray
    judged: Flags
    slow: bool


def truth_of(watched: WatchedContact) -> Truth:
    """Return the truth of a contact up to its release, in which it slips whatever it does.

    Where a body is held, alarms are judged while it stands, too.
    """
    contact = watched.contact
    held = contact.kind in HELD_KINDS
    released_us = int(watched.t_us[-1]) - round(1e6 * (contact.scene.lead_out_s + LIFT_S))
    judged = np.isfinite(watched.share) if held else watched.judged
    judged = judged & watched.touching & (watched.t_us < released_us)
    return Truth(watched.t_us, watched.share, judged, not held and contact.speed_mm_s < SLOW_MM_S)


def alarms_of(method: str, watched: WatchedContact) -> tuple[list[int], list[int]]:
    """Return the times, us, at which a method reports incipient and gross slips."""
    if method == "shift-stops":
        return [], shift_stops(watched)
    monitor = SlipMonitor(watched.reference_px)
    frames = zip(watched.t_us.tolist(), watched.moved_px, watched.touching, strict=True)
    slips = [monitor.update(t_us, moved, bool(touching)) for t_us, moved, touching in frames]
    slips.append(monitor.finish(int(watched.t_us[-1])))
    told = [slip for slip in slips if slip is not None]
    incipient = [slip.incipient_us for slip in told if slip.incipient_us is not None]
    return incipient, [slip.gross_us for slip in told if slip.gross_us is not None]


def shift_stops(watched: WatchedContact) -> list[int]:
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


def slip_scores(truth: Truth, incipient: Sequence[int], gross: Sequence[int]) -> dict[str, float]:
    """Compare alarms, us, with the truth of one contact.

    Of its gross slips only the first is scored: the later ones of a body that turns back or is
    dragged twice are not.
    """
    stuck = np.where(np.isfinite(truth.share), truth.share, 1.0)
    frame_s = float(np.median(np.diff(truth.t_us))) / US_PER_S
    early, late = (incipient, AFTER_INCIPIENT_US), (gross, AFTER_GROSS_US)
    scores = {
        "false_incipient": _false(truth, stuck, *early, STICKS_SHARE),
        "false_incipient_sticking": _false(truth, stuck, *early, STICKING_SHARE),
        "false_gross": _false(truth, stuck, *late, FALSE_GROSS_SHARE),
        "false_gross_sticking": _false(truth, stuck, *late, STICKING_SHARE),
        "sticking_s": float((truth.judged & (stuck > STICKING_SHARE)).sum()) * frame_s,
    }
    slipped = np.flatnonzero(truth.judged & (stuck < GROSS_SHARE))
    if not len(slipped):
        return scores
    first = int(slipped[0])
    slip_us = int(truth.t_us[first])
    noticed = [
        t_us
        for t_us in gross
        if t_us >= slip_us - AFTER_GROSS_US or stuck[_row(truth, t_us)] < EARLY_SHARE
    ]
    scores["gross_in_time"] = float(bool(noticed) and noticed[0] <= slip_us + LATE_US)
    if noticed:
        scores["gross_delay_ms"] = (noticed[0] - slip_us) / US_PER_MS
    if truth.slow:
        held = np.flatnonzero(stuck[:first] > HELD_SHARE)
        since_us = int(truth.t_us[held[-1]]) - EARLIER_US if len(held) else int(truth.t_us[0])
        told = [t_us for t_us in incipient if since_us <= t_us <= slip_us]
        scores["lead_20ms"] = float(bool(told) and told[0] <= slip_us - LEAD_US)
    return scores


def _row(truth: Truth, t_us: int) -> int:
    return min(int(np.searchsorted(truth.t_us, t_us)), len(truth.t_us) - 1)


def _false(
    truth: Truth, stuck: FloatArray, alarms: Sequence[int], after_us: int, share: float
) -> float:
    """Return how many alarms were given while more than a share stuck all the while."""
    count = 0
    for t_us in alarms:
        around = slice(_row(truth, t_us - BEFORE_US), _row(truth, t_us + after_us) + 1)
        count += bool(truth.judged[_row(truth, t_us)]) and float(stuck[around].min()) > share
    return float(count)
