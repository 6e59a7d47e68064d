"""The definition of a metric."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Metric:
    """A number that each trial yields.

    Attributes:
        name: As in ``report.json``; the unit is in the name.
        unit: ``px``, ``markers`` or ``1`` (a fraction).
        definition: What exactly is measured.
        over_trials: How the values of the trials of a case are combined.
    """

    name: str
    unit: str
    definition: str
    over_trials: Literal["mean", "sum"] = "mean"
