"""From labelled series to a force model, also from one of another sensor of the same kind.

Whatever is judged is judged between the series: each is predicted from the others (or, where there
is only one, each of its parts from the rest). The intervals hold 90 % of the errors made there.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from scipy.optimize import nnls

from spikingtac.errors import ConfigError, require_type
from spikingtac.touch.force import regression
from spikingtac.touch.force.model import SCHEMA, ForceModel, fields_of, other_sensor, rest_share
from spikingtac.touch.force.regression import NORMAL, TINY
from spikingtac.touch.network import Network, with_record
from spikingtac.touch.series import COMPONENTS, WrenchSeries
from spikingtac.types import FloatArray

# Of a series: fields (n, size), labels (n, c) and their zero (c,); or labels, wrenches and spreads.
Columns = tuple[FloatArray, FloatArray, FloatArray]

# Parts into which a single series is cut, in time, so that each is predicted from the rest.
PARTS = 5
KIND = "ridge and Gaussian process"

# Rms distance to the zero below which a frame is one of rest, over the rms of the displacements
# that were learned (0.06 mm of 0.6 mm; markers of data/force scatter by 0.045 mm at rest).
RADIUS_SHARE = 0.1

# Frames of a series, and of all, that are learned from at most, evenly chosen.
FRAMES_PER_SERIES, FRAMES = 3_000, 6_000
CHOOSING_PART = 3  # Part of the frames by which a memory is chosen.

# Errors with a memory, over those without, below which it is kept (0.75 to 0.89 on data/force,
# 0.97 on contacts that are drawn without any creep).
MEMORY_RATIO = 0.92

# Normal force of a light press, over its rms: the other components of the labels then read their
# zero (the zero of the sensor of data/force moves by 0.1 N from series to series).
LIGHT_SHARE = 0.08
LEAST_FRAMES, LEAST_PRESSES = 200, 20  # Fewer labelled frames make no model, or re-target none.
COVERAGE = 0.9  # Share of the errors that an interval holds.

# Which of the series' own stretches an interval takes (of data/force, whose series differ in
# their range of forces, the median holds 95 % of the series within the range of the others).
STRETCH_QUANTILE = 0.25
LEAST_FLOOR_SHARE = 0.1  # Least half-width at rest, over the mean absolute error.

# Displacements of the learned sensor over those of another one under the same force.
SOFTNESS = np.geomspace(0.4, 2.5, 13)


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
    kept, reference, radius = _checked(series, LEAST_FRAMES)

    def crossed(memory: bool, frames: int) -> tuple[list[Columns], list[Columns]]:
        groups = [_taught(one, radius, memory, frames // len(kept)) for one in kept]
        return groups, list(_crossed(groups, reference, radius))

    errors = []  # Of the forces between the series, without and with a memory.
    for memory in (False, True):
        truth, told, _ = _joined(crossed(memory, FRAMES // CHOOSING_PART)[1])
        errors.append(regression.relative_error(told, truth))
        if advance is not None:
            advance(len(errors) / 4)
    memory = errors[1] < MEMORY_RATIO * errors[0]
    groups, parts = crossed(memory, FRAMES)
    record = {
        "schema": SCHEMA,
        "unit": kept[0].unit,
        "reference": reference.round(5).tolist(),
        "rest_radius": radius,
        "memory": memory,
        "kind": KIND,
        "series": [one.name for one in kept],
        **_judged(parts),
    }
    return ForceModel(Network(with_record(_fitted(groups, reference), record)))


def score_force(model: ForceModel, series: WrenchSeries) -> list[ForceScore]:
    """Score a model on a series with a wrench.

    Raises:
        ConfigError: The series holds no wrench, or does not fit the model.
    """
    if series.wrench.shape[1] < 3:
        raise ConfigError(f"{series.name} holds no wrench to compare with; give it with --wrench")
    values, widths = model.estimate(series)
    columns, rows = zip(model.components, series.wrench.T, values.T, widths.T, strict=False), []
    for name, truth, told, width in columns:
        error, unit = np.abs(truth - told), "N" if name.startswith("f") else "Nm"
        means = float(error.mean()), float((error <= width).mean())
        rows.append(ForceScore(name, regression.r_squared(truth, told), *means, len(truth), unit))
    return rows


def _checked(
    series: Sequence[WrenchSeries], least: int, components: int = NORMAL + 1
) -> tuple[list[WrenchSeries], FloatArray, float]:
    """Return series in the image, their markers, and the largest rms distance of a frame at rest.

    Raises:
        ConfigError: They are too short, still, without a wrench, or do not fit each other.
    """
    given: Sequence[Any] = series if isinstance(series, list | tuple) else [series]
    if not given:
        raise ConfigError("no series was given; give files with t_us, displacements and a wrench")
    for one in given:
        require_type(one, WrenchSeries, "touch.load_series('contacts.npz')")
    kept = [one.in_image() for one in given]
    first, components = kept[0], max(components, kept[0].wrench.shape[1])
    for number, one in enumerate(kept):
        if not one.displacement.any():
            raise ConfigError(f"{one.name}: no marker moves in its {len(one.t_us)} frames")
        if one.wrench.shape[1] < components or not np.ptp(one.wrench[:, NORMAL]):
            raise ConfigError(
                f"{one.name} holds no wrench of {components} components (N, Nm), or one whose "
                "normal force never changes: give --wrench"
            )
        if why := other_sensor(one.reference, one.unit, first.reference, first.unit, first.name):
            raise ConfigError(f"{one.name} has {why}; a force model belongs to one sensor")
        if any(np.array_equal(one.displacement, other.displacement) for other in kept[:number]):
            raise ConfigError(f"{one.name} was given twice: a model is tested on other series")
    if (frames := sum(len(one.t_us) for one in kept)) < least:
        raise ConfigError(f"{frames} labelled frames are too few for a model, at least {least}")
    moved = np.concatenate([one.displacement.ravel() for one in kept])
    reference = np.mean([one.reference for one in kept], axis=0)
    return kept, reference, RADIUS_SHARE * float(np.sqrt((moved**2).mean()))


def _taught(series: WrenchSeries, radius: float, memory: bool, frames: int) -> Columns:
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
    return fields[::every], series.wrench[::every], zero


def _crossed(groups: list[Columns], reference: FloatArray, radius: float) -> Iterator[Columns]:
    """Yield labels, wrenches and spreads ``(n, c)`` of each series as the others tell them.

    Of a single series those of its parts.
    """
    if len(groups) == 1:
        fields, wrench, zero = groups[0]
        cuts = np.array_split(fields, PARTS), np.array_split(wrench, PARTS)
        groups = [(*part, zero) for part in zip(*cuts, strict=True)]
    for number, (fields, wrench, _) in enumerate(groups):
        network = Network(_fitted(groups[:number] + groups[number + 1 :], reference))
        values, spread = network(fields)
        at_rest = network(np.zeros((1, reference.size)))[0]
        yield wrench, values - rest_share(fields, radius) * at_rest, spread


def _fitted(groups: Sequence[Columns], reference: FloatArray) -> bytes:
    fields = np.concatenate([one for one, _, _ in groups])
    wrench = np.concatenate([labels - zero for _, labels, zero in groups])
    return regression.fit_regression(
        reference, fields, wrench, np.mean([zero for *_, zero in groups], axis=0)
    )


def _joined(parts: Iterable[tuple[FloatArray, ...]]) -> list[FloatArray]:
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def _judged(parts: list[Columns]) -> dict[str, Any]:
    """Return intervals, ranges and R2 of what the series tell of each other."""
    truth, told, spread = _joined(parts)
    ends = np.cumsum([len(one) for one, _, _ in parts])[:-1]
    columns = list(zip(truth.T, told.T, spread.T, strict=True))
    ranges = [[round(float(one.min()), 4), round(float(one.max()), 4)] for one in truth.T]
    scores = [round(regression.r_squared(true, value), 4) for true, value, _ in columns]
    return {
        "interval": [_interval(*column, ends) for column in columns],
        "frames": len(truth),
        "range": dict(zip(COMPONENTS, ranges, strict=False)),
        "r2_between_series": dict(zip(COMPONENTS, scores, strict=False)),
    }


def _interval(
    truth: FloatArray, told: FloatArray, spread: FloatArray, ends: NDArray[np.int64]
) -> list[float]:
    """Return floor, share of the amount and factor of the spread of a 90 % interval.

    They are fitted to the absolute errors of series that were left out, and then stretched until
    the interval holds its share of them (split conformal prediction, the scores normalised by the
    width). The stretch is the lower quartile of those of the series: the model that ships has
    learned from all of them. ``ends`` are the rows at which the series end.
    """
    error, rows = np.abs(truth - told), np.column_stack([np.ones(len(told)), np.abs(told), spread])
    parts, _ = nnls(rows, error)
    parts[0] = max(parts[0], LEAST_FLOOR_SHARE * float(error.mean()))
    if parts[0] <= 0.0:  # a component that is always zero is known exactly
        return [0.0, 0.0, 0.0]
    stretches = [np.quantile(one, COVERAGE) for one in np.split(error / (rows @ parts), ends)]
    return (float(np.quantile(stretches, STRETCH_QUANTILE)) * parts).tolist()


def retarget(model: ForceModel, series: Sequence[WrenchSeries]) -> ForceModel:
    """Return a model for the sensor of some labelled presses.

    Displacements of its markers are interpolated at the places of those that were learned. A factor
    of softness, and a linear map of the wrench, are fitted to the presses. The intervals are those
    of the model, stretched where parts of the presses are told worse by the others.

    Raises:
        ConfigError: There are too few, or they do not fit each other or the model.
    """
    count = len(model.components)
    kept, reference, radius = _checked(series, LEAST_PRESSES, count)
    fields = np.concatenate([fields_of(one, radius, model.memory) for one in kept])
    wrench = np.concatenate([one.wrench[:, :count] for one in kept])
    scale = float((np.ptp(model.reference, axis=0) / np.ptp(reference, axis=0)).mean())
    places = (model.reference - model.reference.mean(axis=0)) / scale + reference.mean(axis=0)
    resample = scale * RBFInterpolator(reference, np.eye(len(reference)))(places)
    seen = np.einsum("mk,nkd->nmd", resample, fields.reshape(len(fields), -1, 2))
    heard = [(one, *model.network(one * seen.reshape(len(seen), -1))) for one in SOFTNESS]
    base, rows, tested = np.array(model.record["interval"]).T, np.arange(len(wrench)), 1.0 * wrench
    softness, gain, *_ = _adapted(heard, base, wrench, rows)
    ratios = np.empty(wrench.shape)
    for part in np.array_split(rows, PARTS):  # each is told by the others
        _, _, told, width = _adapted(heard, base, wrench, np.delete(rows, part))
        tested[part], ratios[part] = told[part], (np.abs(told - wrench) / width)[part]
    stretch = np.maximum(np.quantile(ratios, COVERAGE, axis=0), 1.0)
    scores = [
        round(regression.r_squared(*pair), 4) for pair in zip(wrench.T, tested.T, strict=True)
    ]
    changes = {
        "unit": kept[0].unit,
        "reference": reference.round(5).tolist(),
        "rest_radius": radius,
        "target": {"resample": (softness * resample).round(7).tolist(), "gain": gain.tolist()},
        "interval": (stretch * [base[0] @ np.abs(gain), *base[1:]]).T.tolist(),
        "retargeted_with": [one.name for one in kept],
        "r2_between_series": dict(zip(COMPONENTS, scores, strict=False)),
        "frames": len(wrench),
    }
    return ForceModel(Network(with_record(model.network.content, model.record | changes)))


def _adapted(
    heard: list[Any], base: FloatArray, wrench: FloatArray, taught: NDArray[Any]
) -> tuple[Any, ...]:
    """Return softness, gain, wrenches and half-widths of all frames, as some of them teach it."""
    fits = []
    for softness, told, spread in heard:
        gain = regression.fitted_gain(told[taught], wrench[taught])
        values, size = told @ gain, np.abs(gain)
        width = base[0] @ size + base[1] * np.abs(values) + base[2] * (spread @ size) + TINY
        error = regression.relative_error(values[taught], wrench[taught])
        fits.append((error, softness, gain, values, width))
    return min(fits, key=lambda fit: fit[0])[1:]
