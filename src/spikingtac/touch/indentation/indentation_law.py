"""From motion and growth of a neighbourhood to the indentation under its marker, with its error.

A small network with two layers of hyperbolic tangents, fitted to contacts on the twin, whose skin
is known everywhere (``scripts/fit_indentation_law.py``). It tells the indentation in pitches of the
markers and the logarithm of its standard deviation (A. Kendall and Y. Gal, "What uncertainties do
we need in Bayesian deep learning for computer vision?", NeurIPS 2017). A real skin's indentation
was never measured with it.
"""

from __future__ import annotations

import importlib.resources
import json
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.touch.indentation.field_features import FEATURES

Field = NDArray[np.float64]

SCHEMA = 1
"""Version of the file of weights."""
FILE = "indentation_law.json"
OUTPUTS = 2
DEPTH_SCALE, SIGMA_SCALE = 0.1, 0.02
"""Pitches that an output of 1 stands for, and standard deviation at a logarithm of 0."""
LOG_SIGMA = (-4.0, 3.0)
"""Range of that logarithm."""
LAYERS = ("first", "second", "told")


@dataclass(frozen=True)
class IndentationLaw:
    """Weights of the network.

    Attributes:
        weights: Of the three layers, ``(outputs, inputs)`` each.
        offsets: Of the three layers, ``(outputs,)`` each.
        error_factor: By what the network's standard deviations are multiplied: events err more
            than what it was fitted to.
    """

    weights: tuple[Field, Field, Field]
    offsets: tuple[Field, Field, Field]
    error_factor: float = 1.0

    def __post_init__(self) -> None:
        inputs = FEATURES
        for weights, offsets in zip(self.weights, self.offsets, strict=True):
            if weights.shape != (len(offsets), inputs):
                raise ValueError(f"a layer of {weights.shape} does not follow {inputs} values")
            inputs = len(offsets)
        if inputs != OUTPUTS or not self.error_factor > 0:
            raise ValueError(f"{inputs} outputs, {OUTPUTS} are needed, and a positive factor")

    def __call__(self, features: Field) -> tuple[Field, Field]:
        """Return indentations ``(...,)`` and their standard deviations, in pitches.

        Args:
            features: ``(..., FEATURES)``.
        """
        seen = np.tanh(features @ self.weights[0].T + self.offsets[0])
        seen = np.tanh(seen @ self.weights[1].T + self.offsets[1])
        told = seen @ self.weights[2].T + self.offsets[2]
        sigma = np.exp(np.clip(told[..., 1], *LOG_SIGMA))
        return DEPTH_SCALE * told[..., 0], SIGMA_SCALE * self.error_factor * sigma

    def to_mapping(self) -> dict[str, Any]:
        """Return the law as plain values."""
        layers = {
            name: {"weights": weights.tolist(), "offsets": offsets.tolist()}
            for name, weights, offsets in zip(LAYERS, self.weights, self.offsets, strict=True)
        }
        return {"schema": SCHEMA, "error_factor": self.error_factor, "layers": layers}

    @classmethod
    def from_mapping(cls, document: dict[str, Any]) -> IndentationLaw:
        """Build a law from plain values.

        Raises:
            ConfigError: They are no law of this version.
        """
        try:
            if document["schema"] != SCHEMA:
                raise ValueError(f"schema {document['schema']}, this version reads {SCHEMA}")
            first, second, told = (document["layers"][name] for name in LAYERS)
            return cls(
                (_array(first, "weights"), _array(second, "weights"), _array(told, "weights")),
                (_array(first, "offsets"), _array(second, "offsets"), _array(told, "offsets")),
                float(document["error_factor"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigError(
                f"no indentation law: {error}; make one with: python scripts/fit_indentation_law.py"
            ) from error


def _array(layer: dict[str, Any], name: str) -> Field:
    return np.array(layer[name], np.float64)


@cache
def fitted_law() -> IndentationLaw:
    """Return the law that comes with the package."""
    file = importlib.resources.files("spikingtac.touch.indentation") / FILE
    return IndentationLaw.from_mapping(json.loads(file.read_text(encoding="utf-8")))
