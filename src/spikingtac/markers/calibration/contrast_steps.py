"""How much of a full swing one event stands for, pixel by pixel, counted from the slides.

While a marker's edge passes a pixel, its log intensity swings over the whole contrast and fires n
events of one polarity in a row. One event is then a step of 1 / (n + 1): n thresholds fit into the
swing, and on the average another half is left over at either end (the dead band). Ours; the paper's
map is binary.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.markers.calibration.slides import Slides

LONGEST_RUN = 255
"""Runs beyond are counted as this long: no sensor fires so often for one edge."""

KNOWN_SWINGS = 3
"""Full swings from which a pixel has a mean of its own."""


@dataclass(frozen=True, kw_only=True, slots=True)
class StepConfig:
    """How full swings are told from noise and partial ones; all values are ours.

    Attributes:
        shortest_share: Shortest run that counts as full, as a share of the usual one. 0.7 parts
            pixels that an edge sweeps from those that it only touches.
        longest_share: Longest, as such a share: longer ones held noise, or two edges.
        prior_swings: Swings at the usual length that each pixel is given beforehand, so that few
            observations do not make wild steps.
        nominal_step: The step where no swing is seen: contrast 6 at a threshold of 0.25.
        fewest_swings: Full swings in all below which the nominal step is taken.
    """

    shortest_share: float = 0.7
    longest_share: float = 1.7
    prior_swings: float = 2.0
    nominal_step: float = 0.15
    fewest_swings: int = 200

    def __post_init__(self) -> None:
        if not 0.0 < self.shortest_share < 1.0 < self.longest_share:
            raise ConfigError(
                f"shortest_share {self.shortest_share} and longest_share {self.longest_share} "
                "must lie on either side of 1"
            )
        if not (self.prior_swings > 0.0 and 0.0 < self.nominal_step <= 1.0):
            raise ConfigError("prior_swings must be positive and 0 < nominal_step <= 1")


@dataclass(frozen=True, slots=True)
class ContrastSteps:
    """What one event of each pixel stands for.

    Attributes:
        on: ``(height, width)`` float32, share of the full swing per ON event.
        off: The same for OFF events.
        mean_on: The sensor's own mean step, ON.
        mean_off: The same, OFF.
        swings: ``(height, width)`` int32, full swings seen, both ways together.
    """

    on: NDArray[np.float32]
    off: NDArray[np.float32]
    mean_on: float
    mean_off: float
    swings: NDArray[np.int32]


def learn_steps(slides: Slides, config: StepConfig) -> ContrastSteps:
    """Count the runs of equal polarity in every pixel and turn full ones into steps."""
    pixels = slides.size[0] * slides.size[1]
    histogram = np.zeros((2, LONGEST_RUN + 1), np.int64)
    count_runs_kernel(slides.code, np.zeros(pixels, np.int32), histogram)
    bounds = np.array([_full_run(histogram[polarity], config) for polarity in (0, 1)])
    total = np.zeros((2, pixels), np.int32)
    swings = np.zeros((2, pixels), np.int32)
    sum_swings_kernel(slides.code, np.zeros(pixels, np.int32), bounds, total, swings)
    steps, means = [], []
    for polarity in (0, 1):
        step, mean = _steps(total[polarity], swings[polarity], config)
        steps.append(step.reshape(slides.shape))
        means.append(mean)
    return ContrastSteps(
        on=steps[1],
        off=steps[0],
        mean_on=means[1],
        mean_off=means[0],
        swings=swings.sum(axis=0).reshape(slides.shape),
    )


def _full_run(histogram: NDArray[np.int64], config: StepConfig) -> tuple[int, int]:
    # Weighted by length, noise (runs of one or two) does not hide the swings.
    length = np.arange(len(histogram))
    usual = int(np.argmax(np.where(length > 1, histogram * length, 0)))
    shortest = max(2, round(config.shortest_share * usual))
    return shortest, max(shortest, int(config.longest_share * usual))


def _steps(
    total: NDArray[np.int32], swings: NDArray[np.int32], config: StepConfig
) -> tuple[NDArray[np.float32], float]:
    if swings.sum() < config.fewest_swings:
        return np.full(len(total), config.nominal_step, np.float32), config.nominal_step
    # The median over pixels is not moved by those at the fringe of a slide, whose swings end early.
    known = swings >= KNOWN_SWINGS
    usual = np.median(total[known] / swings[known]) if known.any() else total.sum() / swings.sum()
    mean = (total + config.prior_swings * usual) / (swings + config.prior_swings)
    return (1.0 / (mean + 1.0)).astype(np.float32), float(1.0 / (usual + 1.0))


@njit(cache=True)
def count_runs_kernel(
    code: NDArray[np.uint32], run: NDArray[np.int32], histogram: NDArray[np.int64]
) -> None:
    """Count the finished runs of every pixel by length; ``run`` is negative while OFF."""
    longest = histogram.shape[1] - 1
    for i in range(len(code)):
        pixel = code[i] >> 1
        length = run[pixel]
        if code[i] & 1:
            if length < 0:
                histogram[0, min(-length, longest)] += 1
            run[pixel] = max(length, 0) + 1
        else:
            if length > 0:
                histogram[1, min(length, longest)] += 1
            run[pixel] = min(length, 0) - 1


@njit(cache=True)
def sum_swings_kernel(
    code: NDArray[np.uint32],
    run: NDArray[np.int32],
    bounds: NDArray[np.int64],
    total: NDArray[np.int32],
    swings: NDArray[np.int32],
) -> None:
    """Sum the lengths of the finished runs inside ``bounds[polarity]``, both ends included."""
    for i in range(len(code)):
        pixel = code[i] >> 1
        length = run[pixel]
        on = code[i] & 1
        if (length < 0) if on else (length > 0):
            polarity = 1 - on
            if bounds[polarity, 0] <= abs(length) <= bounds[polarity, 1]:
                total[polarity, pixel] += abs(length)
                swings[polarity, pixel] += 1
        run[pixel] = (max(length, 0) + 1) if on else (min(length, 0) - 1)
