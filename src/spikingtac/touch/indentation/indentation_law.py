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
from spikingtac.touch.field.mlp import Mlp
from spikingtac.touch.indentation.field_features import FEATURES

Field = NDArray[np.float64]

SCHEMA = 2
"""Version of the file of weights."""
FILE = "indentation_law.json"
OUTPUTS = 2
DEPTH_SCALE, SIGMA_SCALE = 0.1, 0.02
"""Pitches that an output of 1 stands for, and standard deviation at a logarithm of 0."""
LOG_SIGMA = (-4.0, 3.0)
"""Range of that logarithm."""


@dataclass(frozen=True)
class IndentationLaw:
    """What tells the indentation.

    Attributes:
        network: From the features of a marker to its indentation and the logarithm of its
            deviation, both scaled.
        error_factor: By what the network's standard deviations are multiplied: events err more
            than what it was fitted to.
    """

    network: Mlp
    error_factor: float = 1.0

    def __post_init__(self) -> None:
        self.network.require(FEATURES, OUTPUTS)
        if not self.error_factor > 0:
            raise ValueError(f"error_factor is {self.error_factor}, it must be positive")

    def __call__(self, features: Field) -> tuple[Field, Field]:
        """Return indentations ``(...,)`` and their standard deviations, in pitches.

        Args:
            features: ``(..., FEATURES)``.
        """
        told = self.network(features)
        sigma = np.exp(np.clip(told[..., 1], *LOG_SIGMA))
        return DEPTH_SCALE * told[..., 0], SIGMA_SCALE * self.error_factor * sigma

    def to_mapping(self) -> dict[str, Any]:
        """Return the law as plain values."""
        layers = self.network.to_mapping()
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
            network = Mlp.from_mapping(document["layers"])
            return cls(network, float(document["error_factor"]))
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigError(
                f"no indentation law: {error}; make one with: python scripts/fit_indentation_law.py"
            ) from error


@cache
def fitted_law() -> IndentationLaw:
    """Return the law that comes with the package."""
    file = importlib.resources.files("spikingtac.touch.indentation") / FILE
    return IndentationLaw.from_mapping(json.loads(file.read_text(encoding="utf-8")))
