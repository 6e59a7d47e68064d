"""Pixels under markers that move a little. A pixel is updated only when an event may be near.

A marker that moves by a tenth of a pixel changes the light of the pixels around its edge by a
fraction of a threshold. The distance of each pixel to the edge is linear in the motion of the rod,
its light is looked up, and the change detector is that of :mod:`spikingtac.sim.camera.pixels`. A
pixel that cannot reach a threshold for some time waits in a timing wheel for that time, which makes
this fast. The wheel is that of Varghese & Lauck, SOSP 1987, doi:10.1145/41457.37504: a linked list
of pixels for each coming step.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim import (
    change_below_threshold_kernel,
    edge_coverage_kernel,
    emit_crossings_kernel,
    intensity_kernel,
    log_intensity_kernel,
)

# A pixel near an edge, in one record, so that an update touches one place in memory.
EDGE_DTYPE = np.dtype(
    [
        ("inside_px", "f4"),  # distance inside the edge at rest
        ("lowest_level", "f4"),  # range of log light that the motion does not leave
        ("highest_level", "f4"),
        ("filter_index", "i4"),  # index of the low-passed motion that fits the pixel
        ("band_low_px", "f4"),  # no event while the distance stays between these two
        ("band_high_px", "f4"),
        ("band_until_us", "f8"),  # and before this time
        ("slope", "f4", (6,)),  # change of the distance per unit of the bushing, px/mm and px/rad
    ],
    align=True,
)

# Steps for which a band of distances is computed; longer waits go to the timing wheel.
BAND_STEPS = 64
MIN_DELAY_STEPS = 2.0  # Shortest wait for which a pixel is put into the timing wheel, steps.

# Bisection steps for the ends of a band: 1/1000 px, and never beyond the end.
_BISECTION_STEPS = 12


EMPTY = -1  # End of a linked list.


class TimingWheel(NamedTuple):
    """Pixels that are active now, and the step in which each other pixel becomes active again.

    Attributes:
        first: ``(slots,)`` first pixel of each slot's list; -1 if the list is empty.
        following: ``(n,)`` next pixel of the same list; -1 at its end.
        active: ``(n,)`` active pixels. The first ``active_count[0]`` are valid.
        active_count: ``(1,)`` number of active pixels.
        slot: ``(1,)`` slot of the present step.
    """

    first: NDArray[np.int32]
    following: NDArray[np.int32]
    active: NDArray[np.int32]
    active_count: NDArray[np.int64]
    slot: NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy")
def schedule_kernel(wheel: TimingWheel, pixel: int, steps: float) -> None:
    """Make a pixel inactive for a number of steps, at most one turn of the wheel."""
    slots = wheel.first.shape[0]
    slot = (wheel.slot[0] + int(min(steps, slots - 1.0))) % slots
    wheel.following[pixel] = wheel.first[slot]
    wheel.first[slot] = pixel


@njit(cache=True, nogil=True, error_model="numpy")
def pop_due_kernel(wheel: TimingWheel) -> None:
    """Make the pixels of the present slot active and empty the slot."""
    slot = wheel.slot[0]
    pixel = wheel.first[slot]
    wheel.first[slot] = EMPTY
    while pixel >= 0:
        wheel.active[wheel.active_count[0]] = pixel
        wheel.active_count[0] += 1
        pixel = wheel.following[pixel]


def make_timing_wheel(pixels: int, slots: int) -> TimingWheel:
    """Return a wheel with ``slots`` steps, in which all ``pixels`` pixels are active."""
    return TimingWheel(
        first=np.full(slots, EMPTY, np.int32),
        following=np.full(pixels, EMPTY, np.int32),
        active=np.arange(pixels, dtype=np.int32),
        active_count=np.full(1, pixels, np.int64),
        slot=np.zeros(1, np.int64),
    )


class EdgePixels(NamedTuple):
    """The pixels near edges.

    Attributes:
        edges: ``(e,)`` of :data:`EDGE_DTYPE`.
        record: ``(n,)`` index of each pixel in ``edges``; -1 if the pixel is not near an edge.
    """

    edges: NDArray[Any]
    record: NDArray[np.int32]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def edge_distance_kernel(edge: Any, motion: NDArray[np.float32], step: int) -> float:
    """Return how far a pixel lies inside the edge at a step of the motion, px."""
    inside = float(edge["inside_px"])
    filter_index = edge["filter_index"]
    for freedom in range(6):
        inside += float(edge["slope"][freedom]) * float(motion[filter_index, freedom, step])
    return inside


@njit(cache=True, nogil=True, error_model="numpy")
def edge_level_kernel(px: Any, chip: Any, inside_px: float) -> float:
    """Return the log intensity of a pixel at a distance inside the edge, px."""
    return log_intensity_kernel(chip, intensity_kernel(px, edge_coverage_kernel(chip, inside_px)))


@njit(cache=True, nogil=True, error_model="numpy")
def level_crossing_distance_kernel(
    px: Any, chip: Any, here_px: float, level: float, towards: float
) -> float:
    """Return the distance inside the edge, up to which a level is not yet reached, px.

    Args:
        px: Record of :data:`~spikingtac.sim.camera.pixels.PIXEL_DTYPE`.
        chip: Record of :data:`~spikingtac.sim.camera.pixels.CHIP_DTYPE`.
        here_px: Present distance of the pixel inside the edge, px.
        level: Log intensity that must not be reached.
        towards: 1 to search further inside, -1 to search outwards.
    """
    rising = px["marker_increment"] * towards > 0.0
    near = here_px
    far = here_px + towards * 4.0 * chip["edge_half_width_px"]
    for _ in range(_BISECTION_STEPS):
        middle = 0.5 * (near + far)
        found = edge_level_kernel(px, chip, middle)
        if (found < level) if rising else (found > level):
            near = middle
        else:
            far = middle
    return near


@njit(cache=True, nogil=True, error_model="numpy")
def update_band_kernel(px: Any, edge: Any, chip: Any, inside_px: float, span_us: float) -> None:
    """Store the band of distances within which a pixel cannot fire for the next ``span_us``."""
    edge["band_until_us"] = -np.inf
    top = px["level"] + px["threshold_on"] - px["difference"] - px["leak_per_us"] * span_us
    bottom = px["level"] - px["threshold_off"] - px["difference"]
    if px["dead_until_us"] > px["updated_us"] or not bottom < px["level"] < top:
        return
    side = 1.0 if px["marker_increment"] > 0.0 else -1.0
    one = level_crossing_distance_kernel(px, chip, inside_px, top, side)
    two = level_crossing_distance_kernel(px, chip, inside_px, bottom, -side)
    edge["band_low_px"], edge["band_high_px"] = min(one, two), max(one, two)
    edge["band_until_us"] = px["updated_us"] + span_us


@njit(cache=True, nogil=True, error_model="numpy")
def time_to_threshold_kernel(px: Any, lowest: float, highest: float) -> float:
    """Return for how long a pixel cannot fire while its level stays between two limits, us.

    The result is 0 if the pixel may fire at any time, and infinite if no leak moves its reference.
    """
    if (
        px["dead_until_us"] > px["updated_us"]
        or px["difference"] - (px["level"] - lowest) <= -px["threshold_off"]
    ):
        return 0.0
    room = px["threshold_on"] - px["difference"] - (highest - px["level"])
    if room <= 0.0:
        return 0.0
    return room / px["leak_per_us"] if px["leak_per_us"] > 0.0 else np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def advance_level_kernel(px: Any, level: float, until_us: float) -> None:
    """Advance a pixel that cannot have fired to ``until_us``, where its log level is ``level``."""
    if px["updated_us"] < until_us:
        px["difference"] += level - px["level"] + px["leak_per_us"] * (until_us - px["updated_us"])
        px["level"], px["updated_us"] = level, until_us


@njit(cache=True, nogil=True, error_model="numpy")
def update_pixel_kernel(
    px: Any, chip: Any, level: float, until_us: float, out: NDArray[np.int64]
) -> None:
    """Advance a pixel to ``until_us``. Its level moves evenly to ``level`` and may cause events."""
    seen_us = px["updated_us"]
    span_us = until_us - seen_us
    rise = level - px["level"] + px["leak_per_us"] * span_us
    if not change_below_threshold_kernel(px, seen_us, rise):
        emit_crossings_kernel(px, chip, out, seen_us, span_us, rise)
    px["level"], px["updated_us"] = level, until_us


@njit(cache=True, nogil=True, error_model="numpy")
def update_ground_pixel_kernel(
    px: Any, chip: Any, times: tuple[float, float], out: NDArray[np.int64]
) -> float:
    """Update a pixel away from every edge; return how long it cannot fire, us."""
    level = float(px["level"])
    advance_level_kernel(px, level, times[0])
    update_pixel_kernel(px, chip, level, times[1], out)
    return time_to_threshold_kernel(px, level, level)


@njit(cache=True, nogil=True, error_model="numpy")
def update_edge_pixel_kernel(
    px: Any,
    edge: Any,
    chip: Any,
    before_px: float,
    inside_px: float,
    times: tuple[float, float],
    out: NDArray[np.int64],
) -> float:
    """Update a pixel near an edge; return how long it cannot fire, us, or 0 if a band was stored.

    Args:
        px: Record of :data:`~spikingtac.sim.camera.pixels.PIXEL_DTYPE`.
        edge: Record of :data:`EDGE_DTYPE`.
        chip: Record of :data:`~spikingtac.sim.camera.pixels.CHIP_DTYPE`.
        before_px: Distance inside the edge at the start of the step, px.
        inside_px: Distance inside the edge at the end of the step, px.
        times: Start and end of the step, us.
        out: ``out[0]`` counts the events, whose keys follow.
    """
    band_us = BAND_STEPS * (times[1] - times[0])
    advance_level_kernel(px, edge_level_kernel(px, chip, before_px), times[0])
    update_pixel_kernel(px, chip, edge_level_kernel(px, chip, inside_px), times[1], out)
    delay_us = time_to_threshold_kernel(
        px, float(edge["lowest_level"]), float(edge["highest_level"])
    )
    if delay_us > band_us:
        edge["band_until_us"] = -np.inf
        return delay_us
    update_band_kernel(px, edge, chip, inside_px, band_us)
    return 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def idle_steps_kernel(
    edge: Any, motion: NDArray[np.float32], step: int, start_us: float, step_us: float
) -> int:
    """Return for how many steps from ``step`` on the stored band excludes an event.

    Args:
        edge: Record of :data:`EDGE_DTYPE`.
        motion: ``(filters, 6, 1 + steps)`` low-passed bushing.
        step: First step.
        start_us: Start of the first step of ``motion``, us.
        step_us: Length of a step, us.
    """
    if edge["band_until_us"] < start_us + step * step_us:
        return 0
    end = 1 + min(int((edge["band_until_us"] - start_us) / step_us), motion.shape[2] - 1)
    low, high, now = float(edge["band_low_px"]), float(edge["band_high_px"]), step
    while now < end and low < edge_distance_kernel(edge, motion, now) < high:
        now += 1
    return now - step


@njit(cache=True, nogil=True, error_model="numpy")
def small_motion_kernel(
    pixels: NDArray[Any],
    edge_pixels: EdgePixels,
    chip: Any,
    wheel: TimingWheel,
    motion: NDArray[np.float32],
    start_us: float,
    step_us: float,
    out: NDArray[np.int64],
) -> None:
    """Render a stretch of small motion.

    Args:
        pixels: ``(n,)`` of :data:`~spikingtac.sim.camera.pixels.PIXEL_DTYPE`, row-major.
        edge_pixels: Those of them that are near an edge.
        chip: Record of :data:`~spikingtac.sim.camera.pixels.CHIP_DTYPE`.
        wheel: Timing wheel of the pending updates.
        motion: ``(filters, 6, 1 + steps)`` low-passed bushing at the start and after each step.
        start_us: Start of the first step, us.
        step_us: Length of a step, us.
        out: ``out[0]`` counts the events, whose keys follow in no order. Events beyond its end are
            only counted.
    """
    for step in range(1, motion.shape[2]):
        times = (start_us + (step - 1) * step_us, start_us + step * step_us)
        pop_due_kernel(wheel)
        kept = 0
        for n in range(wheel.active_count[0]):
            pixel = wheel.active[n]
            record = edge_pixels.record[pixel]
            idle_steps = 0
            delay_us = 0.0
            if record < 0:
                delay_us = update_ground_pixel_kernel(pixels[pixel], chip, times, out)
            else:
                edge = edge_pixels.edges[record]
                idle_steps = idle_steps_kernel(edge, motion, step, start_us, step_us)
                if idle_steps == 0:
                    before_px = edge_distance_kernel(edge, motion, step - 1)
                    inside_px = edge_distance_kernel(edge, motion, step)
                    delay_us = update_edge_pixel_kernel(
                        pixels[pixel], edge, chip, before_px, inside_px, times, out
                    )
                    idle_steps = 1 + idle_steps_kernel(edge, motion, step + 1, start_us, step_us)
            if delay_us > MIN_DELAY_STEPS * step_us:
                schedule_kernel(wheel, pixel, delay_us / step_us)
            elif idle_steps > 1:
                schedule_kernel(wheel, pixel, float(idle_steps))
            else:
                wheel.active[kept] = pixel
                kept += 1
        wheel.active_count[0] = kept
        wheel.slot[0] = (wheel.slot[0] + 1) % wheel.first.shape[0]
