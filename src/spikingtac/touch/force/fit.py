"""From labelled series to a force model.

Whatever is judged is judged between the series: each is predicted from the others (or, where there
is only one, each of its parts from the rest). The intervals hold 90 % of the errors made there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from spikingtac.errors import ConfigError
from spikingtac.touch.force.model import SCHEMA, ForceModel, fields_of, rest_share
from spikingtac.touch.force.regression import NORMAL, fit_regression
from spikingtac.touch.force.series import COMPONENTS, WrenchSeries
from spikingtac.touch.network import Network, with_record

Field = NDArray[np.float64]

# Parts into which a single series is cut, in time, so that each is predicted from the rest.
PARTS = 5
KIND = "ridge and Gaussian process"

# Rms distance to the zero below which a frame is one of rest, over the rms of the displacements
# that were learned (0.06 mm of 0.6 mm; markers of data/force scatter by 0.045 mm at rest).
RADIUS_SHARE = 0.1

# Frames of a series, and of all, that are learned from at most, evenly chosen.
FRAMES_PER_SERIES, FRAMES = 3_000, 6_000

# Part of the frames by which a memory is chosen, and the share of the time that it takes.
CHOOSING_PART, CHOOSING_SHARE = 3, 0.4

# Errors with a memory, over those without, below which it is kept (0.75 to 0.89 on data/force,
# 0.97 on contacts that are drawn without any creep).
MEMORY_RATIO = 0.92
TINY = 1e-12  # Least variance of a force that is divided by, N squared.

# Normal force of a light press, over its rms: the other components of the labels then read their
# zero (the zero of the sensor of data/force moves by 0.1 N from series to series).
LIGHT_SHARE = 0.08
LEAST_FRAMES = 200  # Fewer labelled frames make no model.
COVERAGE = 0.9  # Share of the errors that an interval holds.

# Which of the series' own stretches an interval takes (of data/force, whose series differ in
# their range of forces, the median holds 95 % of the series within the range of the others).
STRETCH_QUANTILE = 0.25
LEAST_FLOOR_SHARE = 0.1  # Least half-width at rest, over the mean absolute error.


class ForceScore(NamedTuple):
    """How well one component was estimated.

    Attributes:
        component: ``"fx"`` ... ``"mz"``.
        r2: Coefficient of determination against the labels.
        mae: Mean absolute error, N or Nm.
        coverage90: Share of the labels inside the 90 % intervals.
        n: Frames.
        unit: ``"N"`` or ``"Nm"``.
    """

    component: str
    r2: float
    mae: float
    coverage90: float
    n: int
    unit: str


class _Taught(NamedTuple):
    """Frames of one series: fields ``(n, size)``, labels ``(n, c)`` and their zero ``(c,)``."""

    fields: Field
    wrench: Field
    zero: Field


def fit_force(
    series: Sequence[WrenchSeries], advance: Callable[[float], object] | None = None
) -> ForceModel:
    """Learn a force model from labelled series of one sensor.

    Args:
        series: Displacements with wrenches, in order of time, each with its own zero; of three
            coordinates those in the image are used.
        advance: Receives the share that is done, 0 to 1.

    Raises:
        ConfigError: There is too little to learn from, or the series do not fit each other.
    """
    if not series:
        raise ConfigError("no series was given; give files with t_us, displacements and a wrench")
    kept, told_share = [one.in_image() for one in series], advance or (lambda done: None)
    check_series(kept, kept[0].wrench.shape[1], kept[0].reference)
    if (frames := sum(len(one.t_us) for one in kept)) < LEAST_FRAMES:
        raise ConfigError(f"{frames} frames are too few for a model, at least {LEAST_FRAMES}")
    reference, radius = rest_of(kept)

    def taught(memory: bool, frames: int) -> list[_Taught]:
        return [_taught(one, radius, memory, frames // len(kept)) for one in kept]

    # Whether a memory makes the errors of the forces between the series smaller.
    errors = []
    for memory in (False, True):
        parts = _crossed(taught(memory, FRAMES // CHOOSING_PART), reference, radius)
        truth, told, _ = (np.concatenate(column) for column in zip(*parts, strict=True))
        errors.append(relative_error(told, truth))
    memory = errors[1] < MEMORY_RATIO * errors[0]

    groups, crossed = taught(memory, FRAMES), []
    for part in _crossed(groups, reference, radius):
        done = len(crossed) / (len(kept) if len(kept) > 1 else PARTS)
        told_share(CHOOSING_SHARE + (1.0 - CHOOSING_SHARE) * done)
        crossed.append(part)
    record = {
        "schema": SCHEMA,
        "unit": kept[0].unit,
        "reference": reference.round(5).tolist(),
        "rest_radius": radius,
        "memory": memory,
        "kind": KIND,
        "series": [one.name for one in kept],
        **_judged(crossed),
    }
    return ForceModel(Network(with_record(_fitted(groups, reference), record)))


def score_force(model: ForceModel, series: WrenchSeries) -> list[ForceScore]:
    """Score a model on a series with a wrench.

    Raises:
        ConfigError: The series holds no wrench, or does not fit the model.
    """
    if not len(series.t_us) or series.wrench.shape[1] < 3:
        raise ConfigError(f"{series.name} holds no wrench to compare with")
    values, widths = model.estimate(series)
    rows = []
    for name, truth, told, width in zip(
        model.components, series.wrench.T, values.T, widths.T, strict=False
    ):
        error, unit = np.abs(truth - told), "N" if name.startswith("f") else "Nm"
        means = float(error.mean()), float((error <= width).mean())
        rows.append(ForceScore(name, r_squared(truth, told), *means, len(truth), unit))
    return rows


def r_squared(truth: Field, estimate: Field) -> float:
    """Return 1 - (squared errors) / (squared deviations from the mean); 0 for constant truth."""
    spread = float(((truth - truth.mean()) ** 2).sum())
    return 1.0 - float(((truth - estimate) ** 2).sum()) / spread if spread > 0.0 else 0.0


def about(model: ForceModel) -> dict[str, Any]:
    """Return the record of a model without its numbers, for a summary."""
    left_out = ("schema", "reference", "interval", "rest_radius", "memory")
    return {key: value for key, value in model.record.items() if key not in left_out}


def check_series(series: Sequence[WrenchSeries], components: int, markers: Field) -> None:
    """Refuse series without motion, with other markers, or with other components."""
    for one in series:
        if not one.displacement.any():
            raise ConfigError(f"{one.name}: no marker moves in its {len(one.t_us)} frames")
        if one.wrench.shape[1] < NORMAL + 1:
            raise ConfigError(f"{one.name} holds no wrench; forces Fx, Fy, Fz in N are needed")
        if one.reference.shape != markers.shape or one.unit != series[0].unit:
            raise ConfigError(
                f"{one.name} and {series[0].name} differ in markers or unit; "
                "a force model belongs to one sensor"
            )
        if one.wrench.shape[1] < components:
            have = one.wrench.shape[1]
            raise ConfigError(f"{one.name} has {have} components, needed are {components}")


def rest_of(series: Sequence[WrenchSeries]) -> tuple[Field, float]:
    """Return the markers at rest and the largest rms distance of a frame at rest."""
    moved = np.concatenate([one.displacement.ravel() for one in series])
    reference = np.mean([one.reference for one in series], axis=0)
    return reference, RADIUS_SHARE * float(np.sqrt((moved**2).mean()))


def _taught(series: WrenchSeries, radius: float, memory: bool, frames: int) -> _Taught:
    """Return some frames of a series, and what its force sensor reads of no force.

    That is the median of what it reads of light presses. A zero of the normal force cannot be told
    from a light press, so it stays.
    """
    fields = fields_of(series, radius, memory)
    every = -(-len(fields) // min(FRAMES_PER_SERIES, frames))
    pressing = np.abs(series.wrench[:, NORMAL])
    light = pressing <= LIGHT_SHARE * np.sqrt((pressing**2).mean())
    zero = np.median(series.wrench[light], axis=0) if light.any() else 0.0 * series.wrench[0]
    zero[NORMAL] = 0.0
    return _Taught(fields[::every], series.wrench[::every], zero)


def _crossed(
    groups: list[_Taught], reference: Field, radius: float
) -> Iterator[tuple[Field, Field, Field]]:
    """Yield labels, wrenches and spreads ``(n, c)`` of each series as the others tell them.

    Of a single series those of its parts.
    """
    if len(groups) == 1:
        ((fields, wrench, zero),) = groups
        cuts = np.array_split(fields, PARTS), np.array_split(wrench, PARTS)
        groups = [_Taught(*part, zero) for part in zip(*cuts, strict=True)]
    for number, one in enumerate(groups):
        network = Network(_fitted(groups[:number] + groups[number + 1 :], reference))
        values, spread = network(one.fields)
        at_rest = network(np.zeros((1, reference.size)))[0]
        yield one.wrench, values - rest_share(one.fields, radius) * at_rest, spread


def _fitted(groups: Sequence[_Taught], reference: Field) -> bytes:
    fields = np.concatenate([one.fields for one in groups])
    wrench = np.concatenate([one.wrench - one.zero for one in groups])
    return fit_regression(reference, fields, wrench, np.mean([one.zero for one in groups], axis=0))


def relative_error(told: Field, truth: Field) -> float:
    """Return the squared errors of the forces, each over its variance."""
    error = ((told - truth)[:, : NORMAL + 1] ** 2).mean(axis=0)
    return float((error / np.maximum(truth[:, : NORMAL + 1].var(axis=0), TINY)).sum())


def _judged(crossed: list[tuple[Field, Field, Field]]) -> dict[str, Any]:
    """Return intervals, ranges and R2 of what the series tell of each other."""
    truths, told, spreads = zip(*crossed, strict=True)
    truth, values, spread = (np.concatenate(parts) for parts in (truths, told, spreads))
    ends, names = np.cumsum([len(one) for one in truths])[:-1], COMPONENTS[: truth.shape[1]]
    intervals, ranges, scores = [], {}, {}
    for name, true, value, differ in zip(names, truth.T, values.T, spread.T, strict=True):
        intervals.append(_interval(np.abs(true - value), np.abs(value), differ, ends))
        ranges[name] = [round(float(true.min()), 4), round(float(true.max()), 4)]
        scores[name] = round(r_squared(true, value), 4)
    about_series = {"interval": intervals, "frames": len(truth)}
    return about_series | {"range": ranges, "r2_between_series": scores}


def _interval(error: Field, amount: Field, spread: Field, ends: NDArray[np.int64]) -> list[float]:
    """Return floor, share of the amount and factor of the spread of a 90 % interval.

    They are fitted to the absolute errors of series that were left out, and then stretched until
    the interval holds its share of them (split conformal prediction, the scores normalised by the
    width). The stretch is the lower quartile of those of the series: the model that ships has
    learned from all of them. ``ends`` are the rows at which the series end.
    """
    (floor, share, factor), _ = nnls(np.column_stack([np.ones(len(error)), amount, spread]), error)
    floor = max(floor, LEAST_FLOOR_SHARE * float(error.mean()))
    if floor <= 0.0:  # a component that is always zero is known exactly
        return [0.0, 0.0, 0.0]
    scores = np.split(error / (floor + share * amount + factor * spread), ends)
    stretches = [np.quantile(one, COVERAGE) for one in scores]
    stretch = float(np.quantile(stretches, STRETCH_QUANTILE))
    return [stretch * floor, stretch * share, stretch * factor]
