"""A multilayer perceptron as plain arrays: layers of hyperbolic tangents, then a linear one."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]


@dataclass(frozen=True)
class Mlp:
    """Weights of the network.

    Attributes:
        weights: Of each layer, ``(outputs, inputs)``.
        biases: Of each layer, ``(outputs,)``.
    """

    weights: tuple[Field, ...]
    biases: tuple[Field, ...]

    def __post_init__(self) -> None:
        if not self.weights or len(self.weights) != len(self.biases):
            raise ValueError(f"{len(self.weights)} weights and {len(self.biases)} biases")
        for weights, biases in zip(self.weights, self.biases, strict=True):
            if weights.ndim != 2 or biases.shape != weights.shape[:1]:
                raise ValueError(f"weights of {weights.shape} with biases of {biases.shape}")
        for before, after in pairwise(self.weights):
            if after.shape[1] != len(before):
                raise ValueError(f"a layer of {after.shape} does not follow {len(before)} values")

    def require(self, inputs: int, outputs: int) -> None:
        """Raise ValueError unless the network has so many inputs and outputs."""
        found = self.weights[0].shape[1], len(self.weights[-1])
        if found != (inputs, outputs):
            raise ValueError(
                f"a network of {found[0]} inputs and {found[1]} outputs, "
                f"{inputs} and {outputs} are needed"
            )

    def __call__(self, features: Field) -> Field:
        """Return the outputs ``(..., outputs)`` of features ``(..., inputs)``."""
        values = features
        for weights, biases in zip(self.weights[:-1], self.biases[:-1], strict=True):
            values = np.tanh(values @ weights.T + biases)
        return values @ self.weights[-1].T + self.biases[-1]

    def to_mapping(self) -> list[dict[str, Any]]:
        """Return the layers as plain values."""
        return [
            {"weights": weights.tolist(), "biases": biases.tolist()}
            for weights, biases in zip(self.weights, self.biases, strict=True)
        ]

    @classmethod
    def from_mapping(cls, layers: list[dict[str, Any]]) -> Mlp:
        """Build a network from plain values.

        Raises:
            KeyError, TypeError, ValueError: They are no network.
        """
        return cls(
            tuple(np.array(layer["weights"], np.float64) for layer in layers),
            tuple(np.array(layer["biases"], np.float64) for layer in layers),
        )
