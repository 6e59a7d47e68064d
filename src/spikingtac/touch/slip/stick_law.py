"""From the shape of a field to the share of the contact that sticks: a small network.

Two layers of hyperbolic tangents and three logistic outputs, fitted to slides on the twin, whose
sticking part is known (``scripts/fit_slip_law.py``). A real skin's share has no instrument.
"""

from __future__ import annotations

import importlib.resources
import json
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.touch.slip.features import FEATURES

Field = NDArray[np.float64]

SCHEMA = 1
"""Version of the file of weights."""
OUTPUTS = 3
"""The sticking share, and the probabilities of incipient and gross slip."""
FILE = "stick_law.json"
LARGEST_LOGIT = 30.0
"""Limit of a logit, so that nothing overflows."""


class Stuck(NamedTuple):
    """What a law says of a field.

    Attributes:
        share: Share of the contact that sticks, 0 to 1.
        incipient: Probability that a fifth of it or more slips.
        gross: Probability that nine tenths or more slip.
    """

    share: float
    incipient: float
    gross: float


@dataclass(frozen=True)
class StickLaw:
    """Weights of the law.

    Attributes:
        middle: ``(FEATURES,)`` means of the features that were learned from.
        deviation: ``(FEATURES,)`` their standard deviations.
        weights: One matrix per layer, ``(outputs, inputs)``.
        offsets: One vector per layer.
    """

    middle: Field
    deviation: Field
    weights: tuple[Field, ...]
    offsets: tuple[Field, ...]

    def __post_init__(self) -> None:
        inputs = FEATURES
        for matrix, offset in zip(self.weights, self.offsets, strict=True):
            if matrix.shape != (len(offset), inputs):
                raise ValueError(f"a layer of {inputs} inputs has weights {matrix.shape}")
            inputs = len(offset)
        if inputs != OUTPUTS or len(self.middle) != FEATURES or len(self.deviation) != FEATURES:
            raise ValueError(f"a stick law has {FEATURES} features and {OUTPUTS} outputs")

    def __call__(self, features: Field) -> Stuck:
        """Return what the features ``(FEATURES,)`` of a field say."""
        values = (features - self.middle) / self.deviation
        for matrix, offset in zip(self.weights[:-1], self.offsets[:-1], strict=True):
            values = np.tanh(matrix @ values + offset)
        logits = self.weights[-1] @ values + self.offsets[-1]
        return Stuck(*(1.0 / (1.0 + np.exp(-_limited(logits)))).tolist())

    def to_mapping(self) -> dict[str, Any]:
        """Return the law as plain values."""
        return {
            "schema": SCHEMA,
            "middle": self.middle.tolist(),
            "deviation": self.deviation.tolist(),
            "weights": [matrix.tolist() for matrix in self.weights],
            "offsets": [offset.tolist() for offset in self.offsets],
        }

    @classmethod
    def from_mapping(cls, document: dict[str, Any]) -> StickLaw:
        """Build a law from plain values.

        Raises:
            ConfigError: They are no stick law of this version.
        """
        try:
            if document["schema"] != SCHEMA:
                raise ValueError(f"schema {document['schema']}, this version reads {SCHEMA}")
            return cls(
                np.array(document["middle"], np.float64),
                np.array(document["deviation"], np.float64),
                tuple(np.array(matrix, np.float64) for matrix in document["weights"]),
                tuple(np.array(offset, np.float64) for offset in document["offsets"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigError(
                f"no stick law: {error}; make one with: python scripts/fit_slip_law.py"
            ) from error


@cache
def fitted_law() -> StickLaw:
    """Return the law that comes with the package."""
    file = importlib.resources.files("spikingtac.touch.slip") / FILE
    return StickLaw.from_mapping(json.loads(file.read_text(encoding="utf-8")))


def _limited(logits: Field) -> Field:
    return np.minimum(np.maximum(logits, -LARGEST_LOGIT), LARGEST_LOGIT)
