"""One pixel of the twin's event camera: low-pass, change detector, dead time, leak, latency.

A pixel is only looked at when its light changes or when something is due; in between its state is
carried forward in closed form, so that its history never depends on who looked when. The equations
are those of v2e (Hu, Liu, Delbruck 2021, doi:10.1109/CVPRW53098.2021.00144) with the time of each
crossing interpolated and the reference taken at the end of the dead time.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.camera.random import normal_pair_kernel, pixel_counter_kernel

KEY_SHIFT = 24
"""Bits of an event's key below its time: ``(t_us << 24) | (pixel << 1) | on``."""
SETTLED = 5e-4
"""A level this close to its light (log) is at rest; 1/500 of a threshold. The rest is kept."""
SETTLING_STEPS = 4.0
"""Steps per time constant while a pixel settles under constant light."""
_SETTLING_SHARE = 1.0 - math.exp(-1.0 / SETTLING_STEPS)
_SAME_LIGHT = 1e-6
"""Intensities (white = 1) this close are one; the log table is no finer."""
_NEVER_US = 1e18
_STAMP_GAP_US = 1.0
"""A pixel reports its events in order, at least one time unit apart."""

PIXEL_DTYPE = np.dtype(
    [
        ("seen_us", "f8"),  # time to which the pixel has been carried
        ("dead_us", "f8"),  # end of the dead time
        ("due_us", "f8"),  # when the leak reaches the threshold; never while unsettled
        ("stamp_us", "f8"),  # of the last event
        ("intensity", "f4"),  # last light, white = 1
        ("before", "f4"),  # light at the beginning of the span that is being worked on
        ("target", "f4"),  # log of the last light
        ("level", "f4"),  # low-passed log light
        ("gap", "f4"),  # level minus reference; undefined while dead
        ("leak", "f4"),  # present drift of the gap, 1/us
        ("on", "f4"),  # threshold
        ("off", "f4"),  # threshold
        ("mean_leak", "f4"),  # 1/us
        ("base", "f4"),  # light on bare ground
        ("lift", "f4"),  # what a marker adds
        ("fired", "u4"),  # events so far
        ("index", "i4"),  # row by row
        ("listed", "u1"),  # 1 while waiting to settle
    ],
    align=True,
)
"""What a pixel is and remembers: one record, so that one visit touches one place in memory."""

EDGE_ENTRIES = 512
LOG_ENTRIES = 2048
DECAY_ENTRIES = 1024
CHIP_DTYPE = np.dtype(
    [
        ("rate", "f8"),  # inverse time constant per unit of (intensity + dark), 1/us
        ("dark", "f8"),  # dark current as an intensity
        ("refractory_us", "f8"),
        ("latency_us", "f8"),  # at intensity 1
        ("jitter_us", "f8"),
        ("leak_jitter", "f8"),  # relative, drawn after each event
        ("key", "u8"),  # of the random numbers
        ("reach_px", "f8"),  # half-width of an edge: beyond it coverage is exactly 0 or 1
        ("edge_per_px", "f8"),  # entries of ``edge`` per px
        ("log_per_unit", "f8"),  # entries of ``log`` per unit of intensity
        ("decay_per_unit", "f8"),  # entries of ``decay`` per time constant
        ("edge", "f4", (EDGE_ENTRIES,)),  # coverage from -reach_px (outside) to reach_px
        ("log", "f4", (LOG_ENTRIES,)),  # log intensity
        ("decay", "f4", (DECAY_ENTRIES,)),  # exp(-x), the last one 0
    ],
    align=True,
)
"""What all pixels share. Numba counts references to arrays and not to records: hence one record."""


@njit(cache=True, nogil=True, error_model="numpy")
def fire_kernel(
    px: Any, chip: Any, out: NDArray[np.int64], t_us: float, share: float, on: int
) -> None:
    """Leave an event of a pixel that crossed at ``t_us``, delayed by its latency.

    Args:
        px: Record of :data:`PIXEL_DTYPE`.
        chip: Record of :data:`CHIP_DTYPE`.
        out: ``out[0]`` counts the events, whose keys follow; those beyond its end are only counted.
        t_us: Time of the crossing.
        share: Of the way from the light before the span to the present one.
        on: 1 for ON, 0 for OFF.
    """
    counter = pixel_counter_kernel(px["index"], px["fired"])
    first, second = normal_pair_kernel(chip["key"], counter)
    px["fired"] += np.uint32(1)
    px["leak"] = px["mean_leak"] * max(0.0, 1.0 + chip["leak_jitter"] * second)
    intensity = px["before"] + share * (px["intensity"] - px["before"])
    delay_us = chip["latency_us"] / intensity + chip["jitter_us"] * first
    stamp_us = max(t_us + max(delay_us, 0.0), px["stamp_us"] + _STAMP_GAP_US)
    px["stamp_us"] = stamp_us
    n = out[0] + 1
    if n < out.shape[0]:
        out[n] = (np.int64(stamp_us) << KEY_SHIFT) | (np.int64(px["index"]) << 1) | on
    out[0] = n


@njit(cache=True, nogil=True, error_model="numpy")
def cross_kernel(
    px: Any, chip: Any, out: NDArray[np.int64], start_us: float, span_us: float, rise: float
) -> None:
    """Let a pixel's gap change by ``rise``, evenly over the span, and fire on the way."""
    gap = float(px["gap"])
    slope = rise / span_us
    at_us = 0.0
    wait_us = px["dead_us"] - start_us
    if wait_us > 0.0:
        if wait_us >= span_us:
            return
        at_us, gap = wait_us, 0.0
    while True:
        end = gap + slope * (span_us - at_us)
        if end >= px["on"]:
            on, level = 1, float(px["on"])
        elif end <= -px["off"]:
            on, level = 0, -float(px["off"])
        else:
            break
        if end != gap:  # equal where rounding left the gap on its threshold
            at_us += (span_us - at_us) * (level - gap) / (end - gap)
        fire_kernel(px, chip, out, start_us + at_us, at_us / span_us, on)
        at_us += chip["refractory_us"]
        gap = 0.0
        if at_us >= span_us:
            px["dead_us"] = start_us + at_us
            px["gap"] = 0.0
            return
    px["gap"] = end


@njit(cache=True, nogil=True, error_model="numpy")
def quiet_kernel(px: Any, start_us: float, rise: float) -> bool:
    """Let a pixel's gap change by ``rise``; return False, with nothing done, if that may fire.

    Numba counts references whenever an array is handed on; this path of most visits hands on none.
    """
    end = px["gap"] + rise
    if px["dead_us"] > start_us or end >= px["on"] or end <= -px["off"]:
        return False
    px["gap"] = end
    return True


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def rate_kernel(chip: Any, intensity: float) -> float:
    """Return the photoreceptor's inverse time constant at a light, 1/us."""
    return chip["rate"] * (intensity + chip["dark"])


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def log_kernel(chip: Any, intensity: float) -> float:
    """Return the log of an intensity from the table."""
    place = intensity * chip["log_per_unit"]
    low = min(int(place), LOG_ENTRIES - 2)
    first = chip["log"][low]
    return first + (place - low) * (chip["log"][low + 1] - first)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def decay_kernel(chip: Any, time_constants: float) -> float:
    """Return exp(-x) from the table."""
    place = time_constants * chip["decay_per_unit"]
    if place >= DECAY_ENTRIES - 1:
        return 0.0
    low = int(place)
    first = chip["decay"][low]
    return first + (place - low) * (chip["decay"][low + 1] - first)


@njit(cache=True, nogil=True, error_model="numpy")
def carry_kernel(px: Any, until_us: float) -> bool:
    """Carry a settled pixel forward; return False, with nothing done, if more is to be done."""
    span_us = until_us - px["seen_us"]
    if span_us <= 0.0:
        return True
    if px["target"] != px["level"] or not quiet_kernel(px, px["seen_us"], px["leak"] * span_us):
        return False
    px["seen_us"] = until_us
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def hold_kernel(px: Any, chip: Any, out: NDArray[np.int64], until_us: float) -> None:
    """Carry a pixel forward under the light that it last saw."""
    seen_us = px["seen_us"]
    if seen_us >= until_us:
        return
    px["before"] = px["intensity"]
    target = float(px["target"])
    rest = target - px["level"]
    if abs(rest) > SETTLED:
        rate = rate_kernel(chip, px["intensity"])
        step_us, share = 1.0 / (SETTLING_STEPS * rate), _SETTLING_SHARE
        while abs(rest) > SETTLED and seen_us < until_us:
            if seen_us + step_us > until_us:
                step_us = until_us - seen_us
                share = 1.0 - decay_kernel(chip, step_us * rate)
            moved = rest * share
            rise = moved + px["leak"] * step_us
            if not quiet_kernel(px, seen_us, rise):
                cross_kernel(px, chip, out, seen_us, step_us, rise)
            rest -= moved
            seen_us += step_us
    if seen_us < until_us:
        span_us = until_us - seen_us
        cross_kernel(px, chip, out, seen_us, span_us, rest + px["leak"] * span_us)
        rest = 0.0
    px["level"] = target - rest
    px["seen_us"] = until_us


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def intensity_kernel(px: Any, covered: float) -> float:
    """Return the light of a pixel that markers cover by a share of 0 to 1."""
    return px["base"] + px["lift"] * covered


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def unchanged_kernel(px: Any, intensity: float) -> bool:
    """Return True if a pixel sees the light that it saw before."""
    return abs(intensity - px["intensity"]) < _SAME_LIGHT


@njit(cache=True, nogil=True, error_model="numpy")
def relight_kernel(px: Any, chip: Any, intensity: float, until_us: float, span_us: float) -> float:
    """Let a pixel's light move evenly to ``intensity`` over a span; return the gap's rise.

    The pixel must have been carried to the span's beginning.
    """
    target = log_kernel(chip, intensity)
    # The mean light's time constant makes the step accurate to second order.
    time_constants = span_us * rate_kernel(chip, 0.5 * (intensity + px["intensity"]))
    level = float(px["level"])
    lag = (target - px["target"]) / time_constants
    moved = target - lag + (level - px["target"] + lag) * decay_kernel(chip, time_constants)
    px["before"] = px["intensity"]
    px["intensity"] = intensity
    px["target"] = target
    px["level"] = moved
    px["seen_us"] = until_us
    return moved - level + px["leak"] * span_us


@njit(cache=True, nogil=True, error_model="numpy")
def foresee_kernel(px: Any) -> bool:
    """Note when a pixel at rest will next fire from its leak; return False if it is unsettled."""
    if px["target"] != px["level"]:
        px["due_us"] = _NEVER_US
        return False
    due_us = _NEVER_US
    if px["leak"] > 0.0:
        gap = 0.0 if px["dead_us"] > px["seen_us"] else px["gap"]
        due_us = max(px["dead_us"], px["seen_us"]) + (px["on"] - gap) / px["leak"]
    px["due_us"] = due_us
    return True
