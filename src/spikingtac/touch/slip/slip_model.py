"""The slip model: from the features of the field to the share of the contact that sticks.

A body that turns back or stops looks like one that slips, for a moment; what went before tells
them apart, so the networks are recurrent. The model is the mean of four, which were trained in
different ways and two of them on other contacts: their errors differ. They are fitted to contacts
on the twin, whose sticking part is known (``scripts/fit_slip_model.py``). A real skin's share has
no instrument.
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
from spikingtac.touch.slip.feature_stream import FEATURES
from spikingtac.touch.slip.gru import GruNetwork

Field = NDArray[np.float64]

SCHEMA = 4
"""Version of the file of weights."""
OUTPUTS = 2
"""The sticking share, and the probability of incipient slip."""
FILE = "slip_model.json"


class SlipEstimate(NamedTuple):
    """What a model estimates of a contact.

    Attributes:
        share: Share of the contact that sticks, 0 to 1.
        incipient: Probability that part of it slips.
    """

    share: float
    incipient: float


@dataclass(frozen=True)
class SlipModel:
    """The mean of some recurrent networks.

    Attributes:
        networks: The networks; each steps at its own rate.
    """

    networks: tuple[GruNetwork, ...]

    def __post_init__(self) -> None:
        for network in self.networks:
            if (len(network.mean), len(network.head.bias)) != (FEATURES, OUTPUTS):
                raise ValueError(f"a slip model has {FEATURES} features and {OUTPUTS} outputs")
        if not self.networks:
            raise ValueError("a slip model has one network or more")

    def estimator(self) -> SlipEstimator:
        """Return an estimator of one contact after the other."""
        return SlipEstimator(self)

    def to_mapping(self) -> dict[str, Any]:
        """Return the model as plain values."""
        return {
            "schema": SCHEMA,
            "networks": [network.to_mapping() for network in self.networks],
        }

    @classmethod
    def from_mapping(cls, document: dict[str, Any]) -> SlipModel:
        """Build a model from plain values.

        Raises:
            ConfigError: They are no slip model of this version.
        """
        try:
            if document["schema"] != SCHEMA:
                raise ValueError(f"schema {document['schema']}, this version reads {SCHEMA}")
            return cls(tuple(GruNetwork.from_mapping(one) for one in document["networks"]))
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigError(
                f"no slip model: {error}; make one with: python scripts/fit_slip_model.py"
            ) from error


class SlipEstimator:
    """Applies a model to the frames of a contact, causally."""

    def __init__(self, model: SlipModel) -> None:
        """Start without a contact."""
        self._model = model
        self._outputs = np.zeros((len(model.networks), OUTPUTS))
        self.reset()

    def reset(self) -> None:
        """Forget the contact: nothing has touched for long."""
        self._hidden = [network.initial for network in self._model.networks]
        self._next_us: list[int] | None = None
        self._estimate = SlipEstimate(1.0, 0.0)

    def update(self, t_us: int, features: Field) -> SlipEstimate:
        """Take in the features ``(FEATURES,)`` of a frame and return the model's estimate."""
        if self._next_us is None:
            self._next_us = [t_us] * len(self._hidden)
        stepped = False
        for number, network in enumerate(self._model.networks):
            if t_us < self._next_us[number]:
                continue
            stepped = True
            self._hidden[number], self._outputs[number] = network(self._hidden[number], features)
            self._next_us[number] = max(self._next_us[number] + network.step_us, t_us)
        if stepped:
            self._estimate = SlipEstimate(*self._outputs.mean(axis=0).tolist())
        return self._estimate


@cache
def default_model() -> SlipModel:
    """Return the model that comes with the package."""
    file = importlib.resources.files("spikingtac.touch.slip") / FILE
    return SlipModel.from_mapping(json.loads(file.read_text(encoding="utf-8")))
