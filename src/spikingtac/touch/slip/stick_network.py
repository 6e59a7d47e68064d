"""A small recurrent network: from a course of features to numbers between 0 and 1.

One layer of hyperbolic tangents, a gated recurrent unit (K. Cho and others, "Learning phrase
representations using RNN encoder-decoder", EMNLP 2014), and logistic outputs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.slip.stick_step import StepWeights, stick_step_kernel

Field = NDArray[np.float64]

GATES = 3
"""Parts of a gated unit: reset, update, new."""
SETTLING_STEPS = 500
"""Steps after which the memory of an untouched skin no longer changes (ours)."""


@dataclass(frozen=True, slots=True)
class Layer:
    """An affine map.

    Attributes:
        weights: ``(outputs, inputs)``.
        offsets: ``(outputs,)``.
    """

    weights: Field
    offsets: Field

    @property
    def packed(self) -> Field:
        """``(outputs, inputs + 1)`` weights, then offsets."""
        return np.column_stack([self.weights, self.offsets])

    def require(self, outputs: int, inputs: int) -> None:
        """Raise ValueError unless the map is of that shape."""
        if self.weights.shape != (outputs, inputs) or self.offsets.shape != (outputs,):
            raise ValueError(
                f"a layer of {self.weights.shape} and {self.offsets.shape} is not one of "
                f"{outputs} outputs and {inputs} inputs"
            )


LAYERS = ("seen", "fresh", "kept", "told")
"""The layers of a network, as in its file."""


@dataclass(frozen=True)
class StickNetwork:
    """Weights of a network.

    Attributes:
        step_us: Time between two of its steps, us.
        middle: ``(f,)`` means of the features that were learned from.
        deviation: ``(f,)`` their standard deviations.
        seen: From features to what is seen.
        fresh: From what is seen to the three gates.
        kept: From the memory to the three gates.
        told: From the memory, then what is seen, to the outputs.
    """

    step_us: int
    middle: Field
    deviation: Field
    seen: Layer
    fresh: Layer
    kept: Layer
    told: Layer

    def __post_init__(self) -> None:
        features, seen = len(self.middle), len(self.seen.offsets)
        memory = len(self.kept.offsets) // GATES
        self.seen.require(seen, features)
        self.fresh.require(GATES * memory, seen)
        self.kept.require(GATES * memory, memory)
        self.told.require(len(self.told.offsets), memory + seen)
        if len(self.deviation) != features:
            raise ValueError(f"{features} means and {len(self.deviation)} deviations")
        if not self.step_us > 0:
            raise ValueError(f"step_us is {self.step_us}, it must be positive")

    @cached_property
    def untouched(self) -> Field:
        """``(memory,)`` what is remembered where nothing has touched for long."""
        memory = np.zeros(len(self.kept.offsets) // GATES)
        for _ in range(SETTLING_STEPS):
            memory, _ = self(memory, self.middle)
        return memory

    @cached_property
    def _step(self) -> StepWeights:
        weights = self.seen.weights / self.deviation
        seen = Layer(weights, self.seen.offsets - weights @ self.middle)
        return StepWeights(seen.packed, self.fresh.packed, self.kept.packed, self.told.packed)

    def __call__(self, memory: Field, features: Field) -> tuple[Field, Field]:
        """Return the memory after a step, and the outputs ``(o,)``, 0 to 1.

        Args:
            memory: ``(memory,)`` what was remembered before; :attr:`untouched` at first.
            features: ``(f,)``.
        """
        said = np.empty(len(self.told.offsets))
        return stick_step_kernel(self._step, memory, features, said), said

    def to_mapping(self) -> dict[str, Any]:
        """Return the network as plain values."""
        layers: dict[str, Layer] = {name: getattr(self, name) for name in LAYERS}
        return {
            "step_us": self.step_us,
            "middle": self.middle.tolist(),
            "deviation": self.deviation.tolist(),
        } | {
            name: {"weights": layer.weights.tolist(), "offsets": layer.offsets.tolist()}
            for name, layer in layers.items()
        }

    @classmethod
    def from_mapping(cls, document: dict[str, Any]) -> StickNetwork:
        """Build a network from plain values.

        Raises:
            KeyError, TypeError, ValueError: They are none.
        """
        return cls(
            int(document["step_us"]),
            np.array(document["middle"], np.float64),
            np.array(document["deviation"], np.float64),
            *(_layer(document[name]) for name in LAYERS),
        )


def _layer(document: dict[str, Any]) -> Layer:
    return Layer(
        np.array(document["weights"], np.float64), np.array(document["offsets"], np.float64)
    )
