"""One pixel of the simulated event camera: low-pass, change detector, dead time, leak, latency.

A pixel is updated only when its light changes or when an event is due. In between its state is
advanced in closed form, so that the result does not depend on the times of the updates. The
equations are those of v2e (Hu, Liu, Delbruck 2021, doi:10.1109/CVPRW53098.2021.00144), with
interpolated crossing times and with the reference sampled at the end of the dead time.

Arguments of the kernels: ``px`` is a record of :data:`PIXEL_DTYPE`, ``chip`` one of
:data:`CHIP_DTYPE`; ``out[0]`` counts the events, whose keys follow. Intensities are relative to
white, which is 1.

Random numbers are hashes of (key, counter), so that the order of the computation does not change
them, by the SplitMix64 finaliser (Steele, Lea, Flood 2014, doi:10.1145/2660193.2660195). Every
operand is an unsigned 64-bit integer, because Numba converts a mix of signed and unsigned integers
to float, which ruins such a generator without an error.
"""

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

KEY_SHIFT = 24  # Bits below the time in an event's key: ``(t_us << 24) | (pixel << 1) | on``.
SETTLED_LEVEL = 5e-4  # Log distance from its target at which a level has settled (1/500 threshold).
SETTLING_STEPS = 4.0  # Steps per time constant while a pixel settles under constant light.
_SETTLING_FRACTION = 1.0 - math.exp(-1.0 / SETTLING_STEPS)
_NEVER_US = 1e18
_MIN_EVENT_SPACING_US = 1.0  # Shortest time between two events of one pixel, us; keeps their order.
SAME_LIGHT = 1e-6  # Intensities that differ by less are equal; the log table is no finer.

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_SHIFTS = (np.uint64(30), np.uint64(27), np.uint64(31))
_DROP_TO_53_BITS, _PIXEL_SHIFT = np.uint64(11), np.uint64(32)
_UNIT_53 = 1.0 / (1 << 53)

# Parameters and state of one pixel, in one record: an update touches one place in memory.
# Times, us: up to which the state is valid; end of the dead time; next leak event ("never" while
# unsettled); time stamp of the last event. Light: present one, the one at the start of the present
# span, without a marker, and what full coverage adds; white is 1. Levels: log of the present light,
# the same behind the low-pass, and that minus the reference (undefined in the dead time). Leak:
# present drift of the difference and its mean, 1/us. Number of events so far; row-major index; 1
# while in the list of unsettled pixels.
_TIMES = ("updated_us", "dead_until_us", "leak_due_us", "last_event_us")
_LIGHT = ("intensity", "previous_intensity", "ground_intensity", "marker_increment")
_LEVELS = ("target_level", "level", "difference", "threshold_on", "threshold_off")
_SINGLE = (*_LIGHT, *_LEVELS, "leak_per_us", "mean_leak_per_us")
_WHOLE = [("event_count", "u4"), ("index", "i4"), ("queued", "u1")]
PIXEL_DTYPE = np.dtype(
    [*((name, "f8") for name in _TIMES), *((name, "f4") for name in _SINGLE), *_WHOLE], align=True
)
EDGE_ENTRIES, LOG_ENTRIES, DECAY_ENTRIES = 512, 2048, 1024  # Lengths of the lookup tables.

# Parameters that all pixels share, in one record: Numba counts references to arrays only.
# Inverse time constant per unit of (intensity + dark), 1/us; dead time, latency (at intensity 1)
# and its jitter, us; relative jitter of the leak, drawn after each event; half-width of an edge,
# px, beyond which coverage is exactly 0 or 1; entries of each table per px, unit of intensity and
# time constant; key of the random numbers; coverage from outside to inside of an edge, logarithm
# by intensity, and exp(-x), whose last entry is 0.
_TIMING = ("white_rate_per_us", "dark", "refractory_us", "latency_us", "jitter_us", "leak_jitter")
_SCALES = ("edge_half_width_px", "edge_per_px", "log_per_unit", "decay_per_unit")
_TABLES = [
    ("edge_coverage", "f4", (EDGE_ENTRIES,)),
    ("log_intensity", "f4", (LOG_ENTRIES,)),
    ("decay_table", "f4", (DECAY_ENTRIES,)),
]
CHIP_DTYPE = np.dtype([*((name, "f8") for name in (*_TIMING, *_SCALES)), ("key", "u8"), *_TABLES])


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def uniform_kernel(key: np.uint64, counter: np.uint64) -> float:
    """Return a number uniform in (0, 1) for a uint64 key and a uint64 counter."""
    bits = key + counter * _GOLDEN
    bits = (bits ^ (bits >> _SHIFTS[0])) * _MIX_1
    bits = (bits ^ (bits >> _SHIFTS[1])) * _MIX_2
    bits = bits ^ (bits >> _SHIFTS[2])
    return (np.float64(bits >> _DROP_TO_53_BITS) + 0.5) * _UNIT_53


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def log_intensity_kernel(chip: Any, intensity: float) -> float:
    """Return the logarithm of an intensity from the table."""
    place = intensity * chip["log_per_unit"]
    low = min(int(place), LOG_ENTRIES - 2)
    first = chip["log_intensity"][low]
    return first + (place - low) * (chip["log_intensity"][low + 1] - first)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def exponential_decay_kernel(chip: Any, time_constants: float) -> float:
    """Return exp(-x) from the table for ``x`` time constants."""
    place = time_constants * chip["decay_per_unit"]
    if place >= DECAY_ENTRIES - 1:
        return 0.0
    low = int(place)
    first = chip["decay_table"][low]
    return first + (place - low) * (chip["decay_table"][low + 1] - first)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def intensity_kernel(px: Any, covered: float) -> float:
    """Return the intensity at a pixel of which the markers cover a fraction (0 to 1)."""
    return px["ground_intensity"] + px["marker_increment"] * covered


@njit(cache=True, nogil=True, error_model="numpy")
def emit_event_kernel(
    px: Any, chip: Any, out: NDArray[np.int64], t_us: float, fraction: float, on: int
) -> None:
    """Append one event of a pixel, delayed by the latency, and draw the pixel's next leak rate.

    Events beyond the end of ``out`` are only counted. ``t_us`` is the time of the crossing,
    ``fraction`` its place between the previous light (0) and the present one (1).
    """
    # Two independent normal numbers (Box-Muller transform), for this pixel and this event.
    pixel, count = np.uint64(px["index"]), np.uint64(px["event_count"])
    counter = ((pixel << _PIXEL_SHIFT) + count) * np.uint64(2)
    radius = math.sqrt(-2.0 * math.log(uniform_kernel(chip["key"], counter)))
    angle = 2.0 * math.pi * uniform_kernel(chip["key"], counter + np.uint64(1))
    px["event_count"] += np.uint32(1)
    change = chip["leak_jitter"] * (radius * math.sin(angle))
    px["leak_per_us"] = px["mean_leak_per_us"] * max(0.0, 1.0 + change)
    intensity = px["previous_intensity"] + fraction * (px["intensity"] - px["previous_intensity"])
    delay_us = chip["latency_us"] / intensity + chip["jitter_us"] * (radius * math.cos(angle))
    timestamp_us = max(t_us + max(delay_us, 0.0), px["last_event_us"] + _MIN_EVENT_SPACING_US)
    px["last_event_us"] = timestamp_us
    n = out[0] + 1
    if n < out.shape[0]:
        out[n] = (np.int64(timestamp_us) << KEY_SHIFT) | (np.int64(px["index"]) << 1) | on
    out[0] = n


@njit(cache=True, nogil=True, error_model="numpy")
def emit_crossings_kernel(
    px: Any, chip: Any, out: NDArray[np.int64], start_us: float, span_us: float, rise: float
) -> None:
    """Change a pixel's level difference evenly over a span and emit an event at each crossing.

    ``rise`` is the change of the difference over the span, in log intensity.
    """
    difference = float(px["difference"])
    slope = rise / span_us
    at_us = 0.0
    dead_us = px["dead_until_us"] - start_us
    if dead_us > 0.0:
        if dead_us >= span_us:
            return
        at_us, difference = dead_us, 0.0
    while True:
        end = difference + slope * (span_us - at_us)
        if end >= px["threshold_on"]:
            on, level = 1, float(px["threshold_on"])
        elif end <= -px["threshold_off"]:
            on, level = 0, -float(px["threshold_off"])
        else:
            break
        if end != difference:  # equal where rounding left the difference on its threshold
            at_us += (span_us - at_us) * (level - difference) / (end - difference)
        emit_event_kernel(px, chip, out, start_us + at_us, at_us / span_us, on)
        at_us += chip["refractory_us"]
        difference = 0.0
        if at_us >= span_us:
            px["dead_until_us"] = start_us + at_us
            px["difference"] = 0.0
            return
    px["difference"] = end


@njit(cache=True, nogil=True, error_model="numpy")
def change_below_threshold_kernel(px: Any, start_us: float, rise: float) -> bool:
    """Change a pixel's level difference by ``rise`` if no event results.

    Return False, without any change, in the dead time or where a threshold is reached. There is no
    array argument, at which Numba would count references: most updates take this path.
    """
    end = px["difference"] + rise
    if px["dead_until_us"] > start_us or end >= px["threshold_on"] or end <= -px["threshold_off"]:
        return False
    px["difference"] = end
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def advance_settled_kernel(px: Any, until_us: float) -> bool:
    """Advance a settled pixel to ``until_us`` under constant light if no event results.

    Return False, without any change, if the pixel has not settled or if an event is due.
    """
    span_us = until_us - px["updated_us"]
    if span_us <= 0.0:
        return True
    if px["target_level"] != px["level"] or not change_below_threshold_kernel(
        px, px["updated_us"], px["leak_per_us"] * span_us
    ):
        return False
    px["updated_us"] = until_us
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def advance_constant_light_kernel(
    px: Any, chip: Any, out: NDArray[np.int64], until_us: float
) -> None:
    """Advance a pixel to ``until_us`` under the light that it saw last, and emit its events."""
    now_us = px["updated_us"]
    if now_us >= until_us:
        return
    px["previous_intensity"] = px["intensity"]
    target = float(px["target_level"])
    remaining = target - px["level"]
    if abs(remaining) > SETTLED_LEVEL:
        rate = chip["white_rate_per_us"] * (px["intensity"] + chip["dark"])  # 1 / time constant
        step_us, fraction = 1.0 / (SETTLING_STEPS * rate), _SETTLING_FRACTION
        while abs(remaining) > SETTLED_LEVEL and now_us < until_us:
            if now_us + step_us > until_us:
                step_us = until_us - now_us
                fraction = 1.0 - exponential_decay_kernel(chip, step_us * rate)
            change = remaining * fraction
            rise = change + px["leak_per_us"] * step_us
            if not change_below_threshold_kernel(px, now_us, rise):
                emit_crossings_kernel(px, chip, out, now_us, step_us, rise)
            remaining -= change
            now_us += step_us
    if now_us < until_us:
        span_us = until_us - now_us
        rise = remaining + px["leak_per_us"] * span_us
        emit_crossings_kernel(px, chip, out, now_us, span_us, rise)
        remaining = 0.0
    px["level"] = target - remaining
    px["updated_us"] = until_us


@njit(cache=True, nogil=True, error_model="numpy")
def advance_light_ramp_kernel(
    px: Any, chip: Any, intensity: float, until_us: float, span_us: float
) -> float:
    """Advance the photoreceptor while the light moves evenly to ``intensity`` within a span.

    The pixel must have been advanced to the start of the span. Return the change of the level
    difference over the span, leak included; the caller applies it.
    """
    target, level = log_intensity_kernel(chip, intensity), float(px["level"])
    # The mean light's time constant makes the step accurate to second order.
    mean = 0.5 * (intensity + px["intensity"])
    time_constants = span_us * (chip["white_rate_per_us"] * (mean + chip["dark"]))
    lag = (target - px["target_level"]) / time_constants
    decay = exponential_decay_kernel(chip, time_constants)
    new_level = target - lag + (level - px["target_level"] + lag) * decay
    px["previous_intensity"] = px["intensity"]
    px["intensity"] = intensity
    px["target_level"] = target
    px["level"] = new_level
    px["updated_us"] = until_us
    return new_level - level + px["leak_per_us"] * span_us


@njit(cache=True, nogil=True, error_model="numpy")
def predict_leak_event_kernel(px: Any) -> bool:
    """Store the time of a settled pixel's next leak event; return False if it has not settled."""
    px["leak_due_us"] = _NEVER_US
    if px["target_level"] != px["level"]:
        return False
    if px["leak_per_us"] > 0.0:
        difference = 0.0 if px["dead_until_us"] > px["updated_us"] else px["difference"]
        since_us = max(px["dead_until_us"], px["updated_us"])
        px["leak_due_us"] = since_us + (px["threshold_on"] - difference) / px["leak_per_us"]
    return True
