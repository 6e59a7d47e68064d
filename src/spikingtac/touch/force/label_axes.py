"""Whether measured forces have the axes of contacts that are drawn: learning from both needs it.

A force sensor has axes of its own. Forces along other axes than those of the drawn contacts would
spoil the model without a word, so a law that knows the drawn contacts alone tells the labelled
ones, and what it tells must go along with the labels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.touch.force.laws import LawChoice, fit_component
from spikingtac.touch.force.shape import FieldBasis, FieldFeatures
from spikingtac.touch.force.wrench_series import COMPONENTS

Field = NDArray[np.float64]

FORCES = COMPONENTS[:3]
CLEAR_CORRELATION = 0.5
"""Correlation, or lead of one over another, that is no accident (ours: on the twin's fourteen
contact scenes the right axes go along by 0.86 and more, others by up to 0.8)."""
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
        ConfigError: A force goes along with another axis, or against its own.
    """
    basis = FieldBasis.learn(drawn, dimensions=2, centers=1)
    known, labelled = FieldFeatures(drawn, basis), FieldFeatures(fields, basis)
    told = [fit_component(LAW, known, column)(labelled) for column in drawn_wrench.T[: len(FORCES)]]
    deviation = wrench[:, : len(FORCES)].std(axis=0)
    for axis in np.flatnonzero(deviation > JUDGED_SHARE * deviation.max()):
        along = np.array([_correlation(wrench[:, axis], one) for one in told])
        best = int(np.abs(along).argmax())
        crossed = abs(along[best]) > abs(along[axis]) + CLEAR_CORRELATION
        if along[axis] < -CLEAR_CORRELATION or crossed:
            other = ("-" if along[best] < 0.0 else "") + FORCES[best]
            raise ConfigError(
                f"the labels' {FORCES[axis]} goes along with {other} of the skin's equations "
                f"(correlation {along[best]:.2f}); turn the force sensor's axes: x to the right "
                "and y down in the image, fz positive where the skin is pressed"
            )


def _correlation(first: Field, second: Field) -> float:
    scale = float(first.std() * second.std())
    product = float(((first - first.mean()) * (second - second.mean())).mean())
    return product / scale if scale > 0.0 else 0.0
