"""From labelled series to a force model.

Everything that is chosen is chosen between the training series: each is predicted from the others
(or, where there is only one, each of its parts from the rest). The law of a component is the one
that does this best, and the intervals hold the errors that it makes there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from spikingtac.errors import ConfigError
from spikingtac.touch.force.creep_memory import CreepConfig, CreepMemory
from spikingtac.touch.force.labels.axes import require_same_axes
from spikingtac.touch.force.laws import LawChoice, fit_component
from spikingtac.touch.force.model import ForceModel, Interval, field_rms, fields_from_rest
from spikingtac.touch.force.neighbourhood import DRAWN_CENTERS, unlike_ones
from spikingtac.touch.force.novelty import learn_novelty
from spikingtac.touch.force.rest_zero import RestZero, RestZeroConfig
from spikingtac.touch.force.score import r_squared
from spikingtac.touch.force.shape import FieldBasis, FieldFeatures
from spikingtac.touch.force.wrench_series import COMPONENTS, WrenchSeries

Field = NDArray[np.float64]

LATERAL = (
    LawChoice(("squares",)),
    LawChoice(("squares", "squares", "squares", "kernel")),
    LawChoice(("shape", "squares", "linear", "kernel")),
)
NORMAL = (LawChoice(("normal",), corrected=True), LawChoice(("kernel",)))
CHOICES = dict.fromkeys(COMPONENTS, LATERAL) | {"fz": NORMAL}
"""Component -> the formulas, or means of some, that may describe it (ours: means of unlike formulas
err less than any of them on data/force)."""
LEAST_GAINS = {"fx": 0.1, "fy": 0.1, "fz": 0.2}
"""Component -> share of what the first formula leaves unexplained that another must explain to be
taken. The first one of the normal force holds beyond the learned range, and few series do not tell
two that are alike within them apart. (Ours: a formula that was 6 % better on two recorded series,
with depth, left 43 % of the variance of a third with three times their force; the first one 13 %.
Where a twisted body makes the first one fail, the other leaves less than half. Of the shear, means
that were 6 % better on two series left 10 % more of the third than the first formula, those that
were 19 % better and more left less of it. The moments take the best.)"""
PARTS = 5
"""Parts into which a single series is cut, in time, so that each is predicted from the rest."""
FRAMES_PER_SERIES = 3_000
"""Frames of a series that are learned from, evenly chosen: those of a fast tracker are all alike,
and memory is bounded."""
LEAST_FRAMES = 200
"""Fewer labelled frames make no model."""
COVERAGE = 0.9
"""Share of the errors that an interval holds."""


@dataclass(frozen=True, slots=True)
class _Taught:
    """The training fields of one group, over the rms of all, and their wrench."""

    fields: Field
    wrench: Field


LEAST_FLOOR_SHARE = 0.1
"""Least half-width at rest, as a share of the mean absolute error (ours)."""


def fit_force(
    series: Sequence[WrenchSeries],
    *,
    drawn: Sequence[WrenchSeries] = (),
    depth: bool = False,
    zero: RestZeroConfig | None = None,
    creep: CreepConfig | None = None,
) -> ForceModel:
    """Learn a force model from labelled series of one sensor, from drawn contacts, or from both.

    Args:
        series: Displacements with wrenches, in order of time, each with its own zero. May be empty
            where contacts are drawn.
        drawn: Contacts drawn from the equations of the same skin, which are learned from as well;
            laws and intervals are chosen by the labelled series, where there are any.
        depth: Use the third coordinate where the series have it.
        zero: How the rest is followed.
        creep: How the skin creeps; not at all unless given.

    Raises:
        ConfigError: There is too little to learn from, the series do not fit each other, or labels
            have other axes than drawn contacts.
    """
    zero, creep = zero or RestZeroConfig(), creep or CreepConfig()
    kept = [one if depth else one.in_image() for one in (*series, *drawn)]
    _check(kept, depth)
    rms = field_rms(np.concatenate([one.displacement for one in kept]))
    groups = [_taught(one, rms, zero, creep) for one in kept]
    labelled, others = groups[: len(series)], groups[len(series) :]
    if labelled and others:
        require_same_axes(*_joined(labelled), *_joined(others))
    labelled, others = (_groups(labelled), others) if labelled else (_groups(others), [])
    fields, wrench = _joined(groups)
    learn = partial(FieldBasis.learn, dimensions=kept[0].reference.shape[1])
    if drawn:
        learn = partial(learn, centers=DRAWN_CENTERS, choose=unlike_ones)
    features = FieldFeatures(fields, learn(fields))
    # Drawn contacts hold all forces, so that a formula that fits them needs no head start.
    least_gains = {} if drawn else LEAST_GAINS
    chosen = _choose(_folds(labelled, others, learn), wrench.shape[1], least_gains)
    return ForceModel(
        unit=kept[0].unit,
        reference=np.mean([one.reference for one in kept], axis=0),
        rms=rms,
        basis=features.basis,
        laws=tuple(
            fit_component(choice.law, features, wrench[:, index])
            for index, choice in enumerate(chosen)
        ),
        intervals=tuple(choice.interval for choice in chosen),
        novelty=learn_novelty(fields, features.basis.modes),
        zero=zero,
        creep=creep,
        about=_about(kept, wrench, [choice.r2 for choice in chosen]),
    )


def _check(series: Sequence[WrenchSeries], depth: bool) -> None:
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
    if depth and first.reference.shape[1] < 3:
        raise ConfigError(f"{first.name} holds no depth; fit without --depth")
    frames = sum(len(one.t_us) for one in series)
    if frames < LEAST_FRAMES:
        raise ConfigError(f"{frames} frames are too few for a model, at least {LEAST_FRAMES}")


def _taught(series: WrenchSeries, rms: float, zero: RestZeroConfig, creep: CreepConfig) -> _Taught:
    flat = series.displacement.reshape(len(series.t_us), -1) / rms
    rest = RestZero(zero, zero.radius_share, flat.shape[1])
    fields = fields_from_rest(series.t_us, flat, CreepMemory(creep), rest)
    every = -(-len(flat) // FRAMES_PER_SERIES)
    return _Taught(fields[::every], series.wrench[::every])


def _joined(groups: Sequence[_Taught]) -> tuple[Field, Field]:
    """Return the fields and the wrenches of groups in one array each."""
    fields = np.concatenate([group.fields for group in groups])
    return fields, np.concatenate([group.wrench for group in groups])


def _groups(taught: list[_Taught]) -> list[_Taught]:
    """Return the groups that are predicted from each other."""
    if len(taught) > 1:
        return taught
    cuts = zip(
        np.array_split(taught[0].fields, PARTS),
        np.array_split(taught[0].wrench, PARTS),
        strict=True,
    )
    return [_Taught(fields, wrench) for fields, wrench in cuts]


@dataclass(frozen=True, slots=True)
class _Fold:
    """One group, and the others, from which it is predicted."""

    taught: FieldFeatures
    taught_wrench: Field
    left_out: FieldFeatures
    truth: Field


def _folds(
    groups: list[_Taught], others: list[_Taught], learn: Callable[[Field], FieldBasis]
) -> Iterator[_Fold]:
    """Yield a fold for each group; one after another, since their features are large.

    ``others`` are learned from and never left out.
    """
    for left_out in groups:
        fields, wrench = _joined([one for one in (*groups, *others) if one is not left_out])
        basis = learn(fields)
        yield _Fold(
            FieldFeatures(fields, basis),
            wrench,
            FieldFeatures(left_out.fields, basis),
            left_out.wrench,
        )


@dataclass(frozen=True, slots=True)
class _Chosen:
    """The best law of a component, its interval and its R2 between the groups."""

    law: LawChoice
    interval: Interval
    r2: float


def _choose(
    folds: Iterable[_Fold], components: int, least_gains: Mapping[str, float]
) -> list[_Chosen]:
    """Return the best law of each component."""
    truth: list[Field] = []
    between: dict[tuple[int, LawChoice], list[Field]] = {}
    for fold in folds:
        truth.append(fold.truth)
        for index in range(components):
            for choice in CHOICES[COMPONENTS[index]]:
                law = fit_component(choice, fold.taught, fold.taught_wrench[:, index])
                between.setdefault((index, choice), []).append(law(fold.left_out))
    every = np.concatenate(truth)
    estimates = {key: np.concatenate(parts) for key, parts in between.items()}
    return [
        _chosen(
            every[:, index],
            {choice: estimates[index, choice] for choice in CHOICES[COMPONENTS[index]]},
            least_gains.get(COMPONENTS[index], 0.0),
        )
        for index in range(components)
    ]


def _chosen(truth: Field, between: dict[LawChoice, Field], least_gain: float) -> _Chosen:
    """Choose the law of a component by what each told of groups that it had not seen."""
    unexplained = {choice: 1.0 - r_squared(truth, told) for choice, told in between.items()}
    first, best = next(iter(between)), min(unexplained, key=unexplained.__getitem__)
    if unexplained[best] > (1.0 - least_gain) * unexplained[first]:
        best = first
    interval = _interval(between[best], truth - between[best])
    return _Chosen(best, interval, r_squared(truth, between[best]))


def _interval(estimate: Field, error: Field) -> Interval:
    """Fit floor and share to absolute errors, then stretch them to the wanted coverage."""
    columns = np.column_stack([np.ones(len(error)), np.abs(estimate)])
    (floor, share), _ = nnls(columns, np.abs(error))
    floor = max(floor, LEAST_FLOOR_SHARE * float(np.mean(np.abs(error))))
    if floor <= 0.0:  # a component that is always zero is known exactly
        return Interval(0.0, 0.0)
    stretch = float(np.quantile(np.abs(error) / (floor + share * np.abs(estimate)), COVERAGE))
    return Interval(floor * stretch, share * stretch)


def _about(series: Sequence[WrenchSeries], wrench: Field, between: list[float]) -> dict[str, Any]:
    names = COMPONENTS[: wrench.shape[1]]
    return {
        "series": [one.name for one in series],
        "frames": len(wrench),
        "range": {
            name: [round(float(column.min()), 4), round(float(column.max()), 4)]
            for name, column in zip(names, wrench.T, strict=True)
        },
        "r2_between_series": {
            name: round(value, 4) for name, value in zip(names, between, strict=True)
        },
    }
