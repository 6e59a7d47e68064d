"""What a metric of an experiment is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Metric:
    """One number that a trial yields.

    Attributes:
        name: As in ``report.json``, unit in its name.
        unit: ``px``, ``markers`` or ``1`` (a fraction).
        definition: What exactly is measured.
        over_trials: How the trials of a case are joined.
    """

    name: str
    unit: str
    definition: str
    over_trials: Literal["mean", "sum"] = "mean"
