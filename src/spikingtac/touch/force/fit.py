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
from spikingtac.touch.force.field_stream import RADIUS_SHARE, fields_of
from spikingtac.touch.force.mirror import with_mirrored
from spikingtac.touch.force.model import SCHEMA, ForceModel, rest_share, zero_wrench
from spikingtac.touch.force.regression import NORMAL, fit_regression
from spikingtac.touch.force.series import COMPONENTS, WrenchSeries
from spikingtac.touch.network import Network, with_record

Field = NDArray[np.float64]

# Parts into which a single series is cut, in time, so that each is predicted from the rest.
PARTS = 5
KIND = "ridge and Gaussian process"

# Frames of a series, and of all, that are learned from at most, evenly chosen.
FRAMES_PER_SERIES, FRAMES = 3_000, 6_000

# Part of the frames by which a memory is chosen, and the share of the time that it takes.
CHOOSING_PART, CHOOSING_SHARE = 3, 0.4

# Errors with a memory, over those without, below which it is kept (ours: 0.75 to 0.89 on
# data/force, 0.97 on contacts that are drawn without any creep).
MEMORY_RATIO = 0.92
TINY = 1e-12  # Least variance of a force that is divided by, N squared.

# Normal force of a light press, over its rms: the other components of the labels then read their
# zero (ours: the zero of the sensor of data/force moves by 0.1 N from series to series).
LIGHT_SHARE = 0.08
LEAST_FRAMES = 200  # Fewer labelled frames make no model.
COVERAGE = 0.9  # Share of the errors that an interval holds.

# Which of the series' own stretches an interval takes (ours: of data/force, whose series differ
# in their range of forces, the median holds 95 % of the series within the range of the others).
STRETCH_QUANTILE = 0.25
LEAST_FLOOR_SHARE = 0.1  # Least half-width at rest, over the mean absolute error (ours).


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
    kept, told_share = [one.in_image() for one in series], advance or (lambda done: None)
    _check(kept)
    moved = np.concatenate([one.displacement.ravel() for one in kept])
    radius = RADIUS_SHARE * float(np.sqrt((moved**2).mean()))
    reference = np.mean([one.reference for one in kept], axis=0)
    memory = _remembers(kept, radius, reference)
    told_share(CHOOSING_SHARE)
    groups = [_taught(one, radius, memory, FRAMES // len(kept)) for one in kept]
    cut = _cut(groups)
    told = []
    for number, network in enumerate(_left_out(cut, reference)):
        told.append(_told(network, cut[number].fields, radius))
        told_share(CHOOSING_SHARE + (1.0 - CHOOSING_SHARE) * (number + 1) / (len(cut) + 1))
    record = {
        "schema": SCHEMA,
        "unit": kept[0].unit,
        "reference": reference.round(5).tolist(),
        "rest_radius": radius,
        "memory": memory,
        "kind": KIND,
        "series": [one.name for one in kept],
        **_judged(told, [one.wrench for one in cut]),
    }
    content = with_record(_fitted(groups, reference), record)
    return ForceModel(Network(content, "the force model"))


def _judged(told: list[tuple[Field, Field]], truths: list[Field]) -> dict[str, Any]:
    """Return intervals, ranges and R2 of wrenches and spreads of series that were left out."""
    truth, values = np.concatenate(truths), np.concatenate([value for value, _ in told])
    names = COMPONENTS[: truth.shape[1]]
    intervals = [
        _interval(
            [value[:, k] for value, _ in told],
            [wrench[:, k] for wrench in truths],
            [spread[:, k] for _, spread in told],
        )
        for k in range(len(names))
    ]
    ranges = [[round(float(one.min()), 4), round(float(one.max()), 4)] for one in truth.T]
    scores = [round(r_squared(*pair), 4) for pair in zip(truth.T, values.T, strict=True)]
    return {
        "interval": intervals,
        "frames": len(truth),
        "range": dict(zip(names, ranges, strict=True)),
        "r2_between_series": dict(zip(names, scores, strict=True)),
    }


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
        error = np.abs(truth - told)
        inside, unit = float((error <= width).mean()), "N" if name.startswith("f") else "Nm"
        score = r_squared(truth, told), float(error.mean()), inside, len(truth), unit
        rows.append(ForceScore(name, *score))
    return rows


def r_squared(truth: Field, estimate: Field) -> float:
    """Return 1 - (squared errors) / (squared deviations from the mean); 0 for constant truth."""
    spread = float(((truth - truth.mean()) ** 2).sum())
    return 1.0 - float(((truth - estimate) ** 2).sum()) / spread if spread > 0.0 else 0.0


def _check(series: Sequence[WrenchSeries]) -> None:
    if not series:
        raise ConfigError("no series was given; give files with t_us, displacements and a wrench")
    first = series[0]
    for one in series:
        if not one.displacement.any():
            raise ConfigError(f"{one.name}: no marker moves in its {len(one.t_us)} frames")
        same = one.reference.shape == first.reference.shape and one.unit == first.unit
        if not same or one.wrench.shape[1] != first.wrench.shape[1]:
            raise ConfigError(
                f"{one.name} and {first.name} differ in markers, unit or components; "
                "a force model belongs to one sensor"
            )
    if first.wrench.shape[1] < 3:
        raise ConfigError(f"{first.name} holds no wrench; forces Fx, Fy, Fz in N are needed")
    frames = sum(len(one.t_us) for one in series)
    if frames < LEAST_FRAMES:
        raise ConfigError(f"{frames} frames are too few for a model, at least {LEAST_FRAMES}")


def _taught(series: WrenchSeries, radius: float, memory: bool, frames: int) -> _Taught:
    fields = fields_of(series.t_us, series.displacement, radius, memory)
    every = -(-len(fields) // min(FRAMES_PER_SERIES, frames))
    return _Taught(fields[::every], series.wrench[::every], _label_zero(series.wrench))


def _remembers(series: Sequence[WrenchSeries], radius: float, reference: Field) -> bool:
    """Return whether a memory makes the errors of forces between the series smaller."""
    errors = []
    for memory in (False, True):
        frames = FRAMES // CHOOSING_PART // len(series)
        cut = _cut([_taught(one, radius, memory, frames) for one in series])
        left_out = [
            one.wrench[:, : NORMAL + 1] - _told(network, one.fields, radius)[0][:, : NORMAL + 1]
            for one, network in zip(cut, _left_out(cut, reference), strict=True)
        ]
        force = np.concatenate([one.wrench[:, : NORMAL + 1] for one in cut])
        error = (np.concatenate(left_out) ** 2).mean(axis=0)
        errors.append(float((error / np.maximum(force.var(axis=0), TINY)).sum()))
    return errors[1] < MEMORY_RATIO * errors[0]


def _cut(groups: list[_Taught]) -> list[_Taught]:
    """Return what is left out in turn: the series, or the parts of a single one."""
    return groups if len(groups) > 1 else _parts(groups[0])


def _left_out(cut: list[_Taught], reference: Field) -> Iterator[Network]:
    """Yield the model of all others for each."""
    for number in range(len(cut)):
        others = cut[:number] + cut[number + 1 :]
        yield Network(_fitted(others, reference), "the force model")


def _label_zero(wrench: Field) -> Field:
    """Return what a force sensor reads of no force: the median of what it reads of light presses.

    A normal force of its own cannot be told from a light press, so it stays.
    """
    pressing = np.abs(wrench[:, NORMAL])
    light = pressing <= LIGHT_SHARE * np.sqrt((pressing**2).mean())
    zero = np.median(wrench[light], axis=0) if light.any() else np.zeros(wrench.shape[1])
    zero[NORMAL] = 0.0
    return zero


def _parts(one: _Taught) -> list[_Taught]:
    cuts = np.array_split(one.fields, PARTS), np.array_split(one.wrench, PARTS)
    return [_Taught(fields, wrench, one.zero) for fields, wrench in zip(*cuts, strict=True)]


def _fitted(groups: Sequence[_Taught], reference: Field) -> bytes:
    fields = np.concatenate([one.fields for one in groups])
    wrench = np.concatenate([one.wrench - one.zero for one in groups])
    zero = np.mean([one.zero for one in groups], axis=0)
    return fit_regression(*with_mirrored(reference, fields, wrench), zero)


def _told(network: Network, fields: Field, radius: float) -> tuple[Field, Field]:
    """Return wrenches and spreads ``(n, c)`` of fields, as a model tells them."""
    values, spread = network(fields)
    zero = rest_share(fields, radius)[:, None] * zero_wrench(network, fields.shape[1])
    return values - zero, spread


def _interval(each: list[Field], truths: list[Field], spreads: list[Field]) -> list[float]:
    """Return floor, share of the amount and factor of the spread of a 90 % interval.

    They are fitted to the absolute errors of series that were left out, and then stretched until
    the interval holds its share of them (split conformal prediction, the scores normalised by the
    width). The stretch is the lower quartile of those of the series: the model that ships has
    learned from all of them.
    """
    estimate, truth, spread = (np.concatenate(parts) for parts in (each, truths, spreads))
    error = np.abs(truth - estimate)
    columns = np.column_stack([np.ones(len(error)), np.abs(estimate), spread])
    (floor, share, factor), _ = nnls(columns, error)
    floor = max(floor, LEAST_FLOOR_SHARE * float(error.mean()))
    if floor <= 0.0:  # a component that is always zero is known exactly
        return [0.0, 0.0, 0.0]
    width = floor + share * np.abs(estimate) + factor * spread
    ends = np.cumsum([len(one) for one in each])[:-1]
    stretches = [np.quantile(part, COVERAGE) for part in np.split(error / width, ends)]
    stretch = float(np.quantile(stretches, STRETCH_QUANTILE))
    return [stretch * floor, stretch * share, stretch * factor]


def about(model: ForceModel) -> dict[str, Any]:
    """Return the record of a model without its numbers, for a summary."""
    left_out = ("schema", "reference", "interval", "rest_radius", "memory")
    return {key: value for key, value in model.record.items() if key not in left_out}
