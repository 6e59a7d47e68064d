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
CLEAR_CORRELATION = 0.3
"""Correlation, or lead of one over another, that is no accident (ours: on eight contact scenes the
right axes go along by 0.8 and more)."""
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
    told = [fit_component(LAW, known, drawn_wrench[:, axis])(labelled) for axis in range(3)]
    for axis, name in enumerate(FORCES):
        along = np.array([_correlation(wrench[:, axis], one) for one in told])
        best = int(np.abs(along).argmax())
        crossed = abs(along[best]) > abs(along[axis]) + CLEAR_CORRELATION
        if along[axis] < -CLEAR_CORRELATION or crossed:
            sign = "-" if along[best] < 0.0 else ""
            raise ConfigError(
                f"the labels' {name} goes along with {sign}{FORCES[best]} of the skin's equations "
                f"(correlation {along[best]:.2f}); turn the force sensor's axes: x to the right "
                "and y down in the image, fz positive where the skin is pressed"
            )


def _correlation(first: Field, second: Field) -> float:
    deviation = float(first.std() * second.std())
    if deviation == 0.0:
        return 0.0
    return float(((first - first.mean()) * (second - second.mean())).mean() / deviation)
