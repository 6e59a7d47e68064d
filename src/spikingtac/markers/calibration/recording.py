"""Events of a recording in memory, and its rests.

A static press sends as few events as no contact, so a quiet interval is only a candidate for a rest
without load. The skin looks the same at all rests without load, while presses differ.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError
from spikingtac.events.hot_pixels import HotPixelFilter, judge_events
from spikingtac.events.source import EventSource
from spikingtac.types import US_PER_S, EventPacket, FloatArray

LONGEST_US = 71 * 60 * US_PER_S  # Longest recording, us.

MOST_EVENTS = 100_000_000  # Bound of the memory: 13 bytes for each event.


def buffer_events(source: EventSource, most_us: int | None = None) -> EventPacket:
    """Read a source once, to its end or for ``most_us``.

    Raises:
        CalibrationError: The source holds no events, more than :data:`MOST_EVENTS`, or more than
            71 minutes; says how to cut it.
    """
    packets, count = [], 0
    for packet in map(EventPacket.sound, source):
        packets.append(packet)
        count += len(packet)
        span_us = packet.t_end_us - packets[0].t_start_us
        refuse_long(span_us, count)
        if most_us is not None and span_us >= most_us:
            break
    if not count:
        raise CalibrationError(
            "the recording holds no events, so no marker can be found; record the sensor while "
            "something touches all of its skin"
        )
    return EventPacket.concatenate(packets)


def times_at(events: EventPacket, index: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the times of events by number, us; beyond the end the time of the last one."""
    return events.t[np.minimum(index, len(events) - 1)]


def refuse_long(span_us: int, events: int = 0) -> None:
    """Refuse what exceeds :data:`LONGEST_US` or :data:`MOST_EVENTS`, such as a leap of time.

    Raises:
        CalibrationError: Says how to cut it.
    """
    if events > MOST_EVENTS or span_us > LONGEST_US:
        raise CalibrationError(
            f"the recording holds more than {MOST_EVENTS:,} events or 71 minutes; contacts of "
            "some ten seconds are enough, cut them out with: "
            "spikingtac convert RECORDING OUT --from-us N --to-us N"
        )


def inverted(events: EventPacket) -> EventPacket:
    """Return the same events with swapped polarities (dark markers become bright ones)."""
    return replace(events, p=~events.p)


def coded(packet: EventPacket) -> NDArray[np.uint32]:
    """Return ``uint32[n]`` pixel number times 2, plus 1 where the pixel became brighter."""
    pixel = packet.y.astype(np.uint32) * np.uint32(packet.size[0]) + packet.x
    return pixel * np.uint32(2) + packet.p


def without_hot_pixels(events: EventPacket) -> tuple[EventPacket, NDArray[np.int64]]:
    """Return the events of all pixels but the hot ones, and these ``(h, 2)``, columns and rows."""
    hot_px = judge_events(events).hot_px
    return HotPixelFilter(hot_px, events.size).kept(events), hot_px


# Length of the bins in which events are counted, us, and number of bins in the moving sum: 10 ms
# hold a hundred events of a quiet 320x320 sensor at 0.1 Hz per pixel.
BIN_US, SMOOTH_BINS = 10_000, 5

# Limit of a quiet bin, as a share of the range from the quietest bins (the fifth percentile) to the
# busy ones (measured: creep after a contact is 0.01 to 0.02). The quietest bins are those around,
# since noise grows with each motion: pixels then lie nearer to their thresholds. (Over the whole
# recording, which is the least limit now, five of twelve simulated sensors lack a fifth to three
# quarters of their rests.)
QUIET_SHARE, QUIET_PERCENTILE, AROUND_BINS = 0.03, 5.0, 300

# Lower bound of that limit, in standard deviations of Poisson noise above the quietest bins: counts
# range from 1.6 below their mean (the fifth percentile) to some three above it.
NOISE_DEVIATIONS = 5.0

SHORTEST_REST_BINS = 10  # A rest lasts at least 0.1 s; a slide reverses in less.

MOST_RESTS = 40  # Number of the longest rests that are used: each needs a map in memory.


def quiet_spans(counts: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return ``(n, 2)`` begin and end of each rest, in bins of :data:`BIN_US`, in order.

    Args:
        counts: Events of each bin.
    """
    from scipy.ndimage import percentile_filter  # every verb's start would wait for it

    sums = np.convolve(counts, np.ones(SMOOTH_BINS), "same")
    floor = percentile_filter(sums, QUIET_PERCENTILE, AROUND_BINS, mode="nearest")
    floor = np.maximum(floor, np.percentile(sums, QUIET_PERCENTILE))
    # Half of all events fall into bins at least as busy as this one.
    busiest = np.sort(sums)[::-1]
    busy = float(busiest[np.searchsorted(np.cumsum(busiest), 0.5 * busiest.sum())])
    above = np.maximum(QUIET_SHARE * (busy - floor), NOISE_DEVIATIONS * (np.sqrt(floor) + 1.0))
    quiet = np.concatenate([[0], sums <= floor + above, [0]]).astype(int)
    begins, ends = (np.flatnonzero(np.diff(quiet) == change) for change in (1, -1))
    return np.column_stack([begins, ends])[ends - begins >= SHORTEST_REST_BINS]


def find_rests(events: EventPacket) -> NDArray[np.int64]:
    """Return ``(n, 2)`` first and last time of each rest, us, in order."""
    bins = max(1, (events.t_end_us - events.t_start_us) // BIN_US)
    edges_us = events.t_start_us + np.arange(bins + 1, dtype=np.int64) * BIN_US
    rests = quiet_spans(np.diff(events.t.searchsorted(edges_us)))
    longest = np.argsort(rests[:, 0] - rests[:, 1], kind="stable")[:MOST_RESTS]
    return edges_us[rests[np.sort(longest)]]


def moving_events(events: EventPacket, rests_us: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return ``bool[n]``: which events fall outside of the rests (all, where that is none)."""
    moving = np.ones(len(events), bool)
    for first, last in events.t.searchsorted(rests_us):
        moving[first:last] = False
    return moving if moving.any() else ~moving


def noise_rates(events: EventPacket, rests_us: NDArray[np.int64]) -> FloatArray:
    """Return ``(2,)`` rates of ON and OFF noise, Hz/px, measured at rests; 0 if there are none."""
    silence_s = max(1e-6 * float(np.diff(rests_us, axis=1).sum()), 1e-6)
    off, on = np.bincount(events.p[~moving_events(events, rests_us)], minlength=2)
    return np.array([on, off]) / events.pixels / silence_s


# Windows for the spectrum of the balance of ON and OFF events, ms, and the lowest frequency of
# flicker: lower ones are motion.
FLICKER_MS, SLOWEST_HZ = 200, 80

# Share of all events that alternates at one frequency where the light flickers (recorded and
# simulated sensors: 0.11 at most without, 0.69 with 5 % of light at 100 Hz and thresholds of 0.2).
FLICKER_SHARE = 0.3


def flicker_hz(events: EventPacket) -> float | None:
    """Return the frequency of flicker: of alternating ON and OFF events, Hz; None without it."""
    edges_us = np.arange(events.t_start_us, events.t_end_us + 1, 1_000)
    on, both = (np.diff(t_us.searchsorted(edges_us)) for t_us in (events.t[events.p], events.t))
    balance = 2 * on - both
    windows = balance[: len(balance) // FLICKER_MS * FLICKER_MS].reshape(-1, FLICKER_MS)
    spectrum = np.abs(np.fft.rfft(windows, axis=1)).sum(axis=0)
    spectrum[: SLOWEST_HZ * FLICKER_MS // 1_000] = 0.0
    hz = float(spectrum.argmax()) * 1_000.0 / FLICKER_MS
    return hz if spectrum.max() > FLICKER_SHARE * len(events) else None


# Standard deviation of the Gaussian that removes the noise of single pixels from maps.
SMOOTH_PX = 1.0


def smoothed(level: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a map ``(height, width)`` without the noise of single pixels."""
    # A late import: every verb's start would wait for it.
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(level, SMOOTH_PX), np.float32)


CHANGED_LEVEL = 0.5  # A pixel differs between two rests when its level differs by half a swing.

# Two rests look alike if fewer pixels differ than this share of the pixels that differ between
# unlike rests, or fewer than this number, a third of one marker. Creep leaves a share of less than
# 0.02, a light press 0.1 and more (simulated and recorded presses).
ALIKE_SHARE, ALIKE_PX = 0.05, 40.0

# A recording mostly begins without load: its first rest counts half as much again.
FIRST_BONUS = 0.5


def unloaded_rests(maps: NDArray[np.float32], length_us: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return ``bool[rests]``: the rests without contact.

    Rests that look alike form the connected components of a graph; the component that lasts longest
    is without load.

    Args:
        maps: ``(rests, height, width)`` level maps.
        length_us: ``(rests,)`` duration of each, us.
    """
    # A late import: every verb's start would wait for it.
    from scipy.sparse.csgraph import connected_components

    smooth = [smoothed(level) for level in maps]
    changed = np.array(
        [[(np.abs(one - other) > CHANGED_LEVEL).sum() for other in smooth] for one in smooth]
    )
    limit = max(ALIKE_SHARE * float(np.percentile(changed, 90)), ALIKE_PX)
    _, group = connected_components(changed < limit)
    weight = np.bincount(group, length_us).astype(float)
    weight[group[0]] += FIRST_BONUS * length_us[0]
    return np.asarray(group == weight.argmax())
