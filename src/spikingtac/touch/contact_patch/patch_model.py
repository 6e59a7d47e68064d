"""From the motion of a neighbourhood to the probability that the skin about its marker is touched.

What a marker stands for is divided into five by five cells. The network was fitted to contacts on
the twin, whose touched cells are known (``scripts/fit_patch_model.py``). It was never measured on a
real skin.
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
from spikingtac.touch.contact_patch.patch_features import FEATURES
from spikingtac.touch.field.mlp import Mlp

Field = NDArray[np.float64]

SCHEMA = 1
"""Version of the file of weights."""
FILE = "patch_model.json"
SIDE = 5
"""Cells along each side of a marker's share of the skin (ours: 0.48 mm of the twin's skin, whose
own cells are 0.41 mm)."""


@dataclass(frozen=True)
class PatchModel:
    """What tells the touched cells.

    Attributes:
        network: From the features of a marker to the logits of its cells, row by row.
    """

    network: Mlp

    def __post_init__(self) -> None:
        self.network.require(FEATURES, SIDE * SIDE)

    def probability(self, features: Field) -> Field:
        """Return how probably each cell is touched, ``(..., SIDE * SIDE)``.

        Args:
            features: ``(..., FEATURES)``.
        """
        return 0.5 + 0.5 * np.tanh(0.5 * self.network(features))

    def to_mapping(self) -> dict[str, Any]:
        """Return the model as plain values."""
        return {"schema": SCHEMA, "layers": self.network.to_mapping()}

    @classmethod
    def from_mapping(cls, document: dict[str, Any]) -> PatchModel:
        """Build a model from plain values.

        Raises:
            ConfigError: They are no model of this version.
        """
        try:
            if document["schema"] != SCHEMA:
                raise ValueError(f"schema {document['schema']}, this version reads {SCHEMA}")
            return cls(Mlp.from_mapping(document["layers"]))
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigError(
                f"no patch model: {error}; make one with: python scripts/fit_patch_model.py"
            ) from error


@cache
def default_model() -> PatchModel:
    """Return the model that comes with the package."""
    file = importlib.resources.files("spikingtac.touch.contact_patch") / FILE
    return PatchModel.from_mapping(json.loads(file.read_text(encoding="utf-8")))
