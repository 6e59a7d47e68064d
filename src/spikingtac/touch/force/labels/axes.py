"""Whether measured forces have the axes of contacts that are drawn: learning from both needs it.

A force sensor has axes of its own. Forces along other axes than those of the drawn contacts would
spoil the model without a word, so a law that knows the drawn contacts alone tells the labelled
ones, and what it tells must go along with the labels.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.touch.force.laws import LawChoice, fit_component
from spikingtac.touch.force.shape import FieldBasis, FieldFeatures
from spikingtac.touch.force.wrench_series import COMPONENTS

Field = NDArray[np.float64]

FORCES = COMPONENTS[:3]
CLEAR_CORRELATION = 0.5
"""Correlation, or lead of one order of the axes over another, that is no accident (ours: on the
twin's fourteen contact scenes the right axes go along by 0.86 and more)."""
JUDGED_SHARE = 0.05
"""Deviation of a force, over that of the largest, from which it is judged: what hardly changes goes
along with anything (ours: 0.001 in presses and twists, 0.07 and more where skin is dragged)."""
LAW = LawChoice(("shape",))


def require_same_axes(fields: Field, wrench: Field, drawn: Field, drawn_wrench: Field) -> None:
    """Refuse labels whose axes are not those of the drawn contacts.

    Args:
        fields: ``(n, size)`` labelled fields from their zero, over the training rms.
        wrench: ``(n, c)`` their wrench.
        drawn: ``(k, size)`` fields of drawn contacts, likewise.
        drawn_wrench: ``(k, c)`` their wrench.

    Raises:
        ConfigError: The forces go along with other axes, or against their own.
    """
    basis = FieldBasis.learn(drawn, dimensions=2, centers=1)
    known, labelled = FieldFeatures(drawn, basis), FieldFeatures(fields, basis)
    told = [fit_component(LAW, known, force)(labelled) for force in drawn_wrench.T[: len(FORCES)]]
    forces = wrench.T[: len(FORCES)]
    along = np.array([[_correlation(force, one) for one in told] for force in forces])
    along[_hardly_changes(forces)] = 0.0
    along[:, _hardly_changes(np.array(told))] = 0.0
    axes = np.arange(len(FORCES))
    orders = {order: np.abs(along[axes, order]).sum() for order in permutations(axes.tolist())}
    best = np.array(max(orders, key=orders.__getitem__))
    own = along.diagonal()
    if orders[tuple(best.tolist())] < np.abs(own).sum() + CLEAR_CORRELATION:
        best = axes  # labels of one tilted axis go along with another as well
    wrong = np.flatnonzero((best != axes) | (own < -CLEAR_CORRELATION))
    if len(wrong):
        label, other = int(wrong[0]), int(best[wrong[0]])
        sign = "-" if along[label, other] < 0.0 else ""
        raise ConfigError(
            f"the labels' {FORCES[label]} goes along with {sign}{FORCES[other]} of the skin's "
            f"equations (correlation {along[label, other]:.2f}); turn the force sensor's axes: x "
            "to the right and y down in the image, fz positive where the skin is pressed"
        )


def _hardly_changes(forces: Field) -> NDArray[np.bool_]:
    """Return which of the forces ``(3, n)`` are too small to be judged."""
    deviation = forces.std(axis=1)
    return deviation < JUDGED_SHARE * deviation.max()


def _correlation(first: Field, second: Field) -> float:
    scale = float(first.std() * second.std())
    product = float(((first - first.mean()) * (second - second.mean())).mean())
    return product / scale if scale > 0.0 else 0.0
