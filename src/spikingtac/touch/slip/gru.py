"""A small recurrent network: from a sequence of features to numbers between 0 and 1.

An encoder of hyperbolic tangents, a gated recurrent unit (K. Cho and others, "Learning phrase
representations using RNN encoder-decoder", EMNLP 2014), and a logistic head.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.slip.gru_step import GruWeights, gru_step_kernel

Field = NDArray[np.float64]

GATES = 3
"""Gates of the unit: reset, update, new."""
SETTLING_STEPS = 500
"""Steps after which the hidden state of an untouched skin no longer changes (ours)."""


@dataclass(frozen=True, slots=True)
class Linear:
    """An affine map.

    Attributes:
        weights: ``(outputs, inputs)``.
        bias: ``(outputs,)``.
    """

    weights: Field
    bias: Field

    @property
    def packed(self) -> Field:
        """``(outputs, inputs + 1)`` weights, then bias."""
        return np.column_stack([self.weights, self.bias])

    def require(self, outputs: int, inputs: int) -> None:
        """Raise ValueError unless the map is of that shape."""
        if self.weights.shape != (outputs, inputs) or self.bias.shape != (outputs,):
            raise ValueError(
                f"a layer of {self.weights.shape} and {self.bias.shape} is not one of "
                f"{outputs} outputs and {inputs} inputs"
            )


LAYERS = ("encoder", "input_gates", "hidden_gates", "head")
"""The layers of a network, as in its file."""


@dataclass(frozen=True)
class GruNetwork:
    """Weights of a network.

    Attributes:
        step_us: Time between two of its steps, us.
        mean: ``(f,)`` means of the features that it was fitted to.
        std: ``(f,)`` their standard deviations.
        encoder: From the features to their encoding.
        input_gates: From the encoding to the three gates.
        hidden_gates: From the hidden state to the three gates.
        head: From the hidden state, then the encoding, to the outputs.
    """

    step_us: int
    mean: Field
    std: Field
    encoder: Linear
    input_gates: Linear
    hidden_gates: Linear
    head: Linear

    def __post_init__(self) -> None:
        features, encoding = len(self.mean), len(self.encoder.bias)
        units = len(self.hidden_gates.bias) // GATES
        self.encoder.require(encoding, features)
        self.input_gates.require(GATES * units, encoding)
        self.hidden_gates.require(GATES * units, units)
        self.head.require(len(self.head.bias), units + encoding)
        if len(self.std) != features:
            raise ValueError(f"{features} means and {len(self.std)} standard deviations")
        if not self.step_us > 0:
            raise ValueError(f"step_us is {self.step_us}, it must be positive")

    @cached_property
    def initial(self) -> Field:
        """``(h,)`` the hidden state where nothing has touched for long."""
        hidden = np.zeros(len(self.hidden_gates.bias) // GATES)
        for _ in range(SETTLING_STEPS):
            hidden, _ = self(hidden, self.mean)
        return hidden

    @cached_property
    def _weights(self) -> GruWeights:
        scaled = self.encoder.weights / self.std
        encoder = Linear(scaled, self.encoder.bias - scaled @ self.mean)
        layers = (encoder, self.input_gates, self.hidden_gates, self.head)
        return GruWeights(*(layer.packed for layer in layers))

    def __call__(self, hidden: Field, features: Field) -> tuple[Field, Field]:
        """Return the hidden state after a step, and the outputs ``(o,)``, 0 to 1.

        Args:
            hidden: ``(h,)`` hidden state before; :attr:`initial` at first.
            features: ``(f,)``.
        """
        outputs = np.empty(len(self.head.bias))
        return gru_step_kernel(self._weights, hidden, features, outputs), outputs

    def to_mapping(self) -> dict[str, Any]:
        """Return the network as plain values."""
        layers: dict[str, Linear] = {name: getattr(self, name) for name in LAYERS}
        return {
            "step_us": self.step_us,
            "mean": self.mean.tolist(),
            "std": self.std.tolist(),
        } | {
            name: {"weights": layer.weights.tolist(), "bias": layer.bias.tolist()}
            for name, layer in layers.items()
        }

    @classmethod
    def from_mapping(cls, document: dict[str, Any]) -> GruNetwork:
        """Build a network from plain values.

        Raises:
            KeyError, TypeError, ValueError: They are none.
        """
        return cls(
            int(document["step_us"]),
            np.array(document["mean"], np.float64),
            np.array(document["std"], np.float64),
            *(_linear(document[name]) for name in LAYERS),
        )


def _linear(document: dict[str, Any]) -> Linear:
    return Linear(np.array(document["weights"], np.float64), np.array(document["bias"], np.float64))
