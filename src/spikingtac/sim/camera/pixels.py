"""One pixel of the simulated event camera: low-pass, change detector, dead time, leak, latency.

A pixel is updated only when its light changes or when an event is due. In between its state is
advanced in closed form, so that the result does not depend on the times of the updates. The
equations are those of v2e (Hu, Liu, Delbruck 2021, doi:10.1109/CVPRW53098.2021.00144), with
interpolated crossing times and with the reference sampled at the end of the dead time.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.camera.pixel_records import (
    KEY_SHIFT,
    exponential_decay_kernel,
    inverse_time_constant_kernel,
    log_intensity_kernel,
    normal_pair_kernel,
    pixel_counter_kernel,
)

# Log distance from its target at which a level has settled; 1/500 of a threshold.
SETTLED_LEVEL = 5e-4
SETTLING_STEPS = 4.0  # Steps per time constant while a pixel settles under constant light.
_SETTLING_FRACTION = 1.0 - math.exp(-1.0 / SETTLING_STEPS)
_NEVER_US = 1e18

# Shortest time between two events of one pixel. It keeps them in order.
_MIN_EVENT_SPACING_US = 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def emit_event_kernel(
    px: Any, chip: Any, out: NDArray[np.int64], t_us: float, fraction: float, on: int
) -> None:
    """Append one event of a pixel, delayed by the latency, and draw the pixel's next leak rate.

    Args:
        px: Record of :data:`~spikingtac.sim.camera.pixel_records.PIXEL_DTYPE`.
        chip: Record of :data:`~spikingtac.sim.camera.pixel_records.CHIP_DTYPE`.
        out: ``out[0]`` counts the events, whose keys follow. Events beyond its end are only
            counted.
        t_us: Time of the crossing, us.
        fraction: Position of the crossing between the previous light (0) and the present light (1).
        on: 1 for ON, 0 for OFF.
    """
    counter = pixel_counter_kernel(px["index"], px["event_count"])
    first, second = normal_pair_kernel(chip["key"], counter)
    px["event_count"] += np.uint32(1)
    px["leak_per_us"] = px["mean_leak_per_us"] * max(0.0, 1.0 + chip["leak_jitter"] * second)
    intensity = px["previous_intensity"] + fraction * (px["intensity"] - px["previous_intensity"])
    delay_us = chip["latency_us"] / intensity + chip["jitter_us"] * first
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

    Args:
        px: Record of :data:`~spikingtac.sim.camera.pixel_records.PIXEL_DTYPE`.
        chip: Record of :data:`~spikingtac.sim.camera.pixel_records.CHIP_DTYPE`.
        out: ``out[0]`` counts the events, whose keys follow.
        start_us: Start of the span, us.
        span_us: Length of the span, us.
        rise: Change of the difference over the span, in log intensity.
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

    The function has no array argument: Numba counts references at each call that passes an array,
    and most updates take this path.

    Returns:
        False, without any change, if the pixel is in its dead time or if a threshold is reached.
    """
    end = px["difference"] + rise
    if px["dead_until_us"] > start_us or end >= px["threshold_on"] or end <= -px["threshold_off"]:
        return False
    px["difference"] = end
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def advance_settled_kernel(px: Any, until_us: float) -> bool:
    """Advance a settled pixel to ``until_us`` under constant light if no event results.

    Returns:
        False, without any change, if the pixel has not settled or if an event is due.
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
    """Advance a pixel to ``until_us`` under the light that it saw last, and emit its events.

    Args:
        px: Record of :data:`~spikingtac.sim.camera.pixel_records.PIXEL_DTYPE`.
        chip: Record of :data:`~spikingtac.sim.camera.pixel_records.CHIP_DTYPE`.
        out: ``out[0]`` counts the events, whose keys follow.
        until_us: End of the interval, us.
    """
    now_us = px["updated_us"]
    if now_us >= until_us:
        return
    px["previous_intensity"] = px["intensity"]
    target = float(px["target_level"])
    remaining = target - px["level"]
    if abs(remaining) > SETTLED_LEVEL:
        rate = inverse_time_constant_kernel(chip, px["intensity"])
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
        emit_crossings_kernel(
            px, chip, out, now_us, span_us, remaining + px["leak_per_us"] * span_us
        )
        remaining = 0.0
    px["level"] = target - remaining
    px["updated_us"] = until_us


@njit(cache=True, nogil=True, error_model="numpy")
def advance_light_ramp_kernel(
    px: Any, chip: Any, intensity: float, until_us: float, span_us: float
) -> float:
    """Advance the photoreceptor while the light moves evenly to ``intensity``.

    The pixel must have been advanced to the start of the span.

    Args:
        px: Record of :data:`~spikingtac.sim.camera.pixel_records.PIXEL_DTYPE`.
        chip: Record of :data:`~spikingtac.sim.camera.pixel_records.CHIP_DTYPE`.
        intensity: Intensity at the end of the span.
        until_us: End of the span, us.
        span_us: Length of the span, us.

    Returns:
        Change of the level difference over the span, leak included. The caller applies it.
    """
    target = log_intensity_kernel(chip, intensity)
    # The mean light's time constant makes the step accurate to second order.
    time_constants = span_us * inverse_time_constant_kernel(
        chip, 0.5 * (intensity + px["intensity"])
    )
    level = float(px["level"])
    lag = (target - px["target_level"]) / time_constants
    new_level = (
        target
        - lag
        + (level - px["target_level"] + lag) * exponential_decay_kernel(chip, time_constants)
    )
    px["previous_intensity"] = px["intensity"]
    px["intensity"] = intensity
    px["target_level"] = target
    px["level"] = new_level
    px["updated_us"] = until_us
    return new_level - level + px["leak_per_us"] * span_us


@njit(cache=True, nogil=True, error_model="numpy")
def predict_leak_event_kernel(px: Any) -> bool:
    """Store the time of a settled pixel's next leak event.

    Returns:
        False if the pixel has not settled; its time is then "never".
    """
    if px["target_level"] != px["level"]:
        px["leak_due_us"] = _NEVER_US
        return False
    due_us = _NEVER_US
    if px["leak_per_us"] > 0.0:
        difference = 0.0 if px["dead_until_us"] > px["updated_us"] else px["difference"]
        due_us = (
            max(px["dead_until_us"], px["updated_us"])
            + (px["threshold_on"] - difference) / px["leak_per_us"]
        )
    px["leak_due_us"] = due_us
    return True
