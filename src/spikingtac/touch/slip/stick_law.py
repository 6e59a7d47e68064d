"""From the course of a field's shape to the share of the contact that sticks.

A body that turns back or stops looks like one that slips, for a moment; what went before tells
them apart, so the networks have a memory. The law is the mean of two, which were taught in
different ways: their errors differ. They are fitted to contacts on the twin, whose sticking part
is known (``scripts/fit_slip_law.py``). A real skin's share has no instrument.
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
from spikingtac.touch.slip.stick_network import StickNetwork

Field = NDArray[np.float64]

SCHEMA = 3
"""Version of the file of weights."""
OUTPUTS = 2
"""The sticking share, and the probability of incipient slip."""
FILE = "stick_law.json"


class Stuck(NamedTuple):
    """The output of a law for a contact.

    Attributes:
        share: Share of the contact that sticks, 0 to 1.
        incipient: Probability that part of it slips.
    """

    share: float
    incipient: float


@dataclass(frozen=True)
class StickLaw:
    """The mean of some networks.

    Attributes:
        networks: The networks; each steps at its own rate.
    """

    networks: tuple[StickNetwork, ...]

    def __post_init__(self) -> None:
        for network in self.networks:
            if (len(network.middle), len(network.told.offsets)) != (FEATURES, OUTPUTS):
                raise ValueError(f"a stick law has {FEATURES} features and {OUTPUTS} outputs")
        if not self.networks:
            raise ValueError("a stick law has one network or more")

    def course(self) -> StickCourse:
        """Return what follows one contact after the other."""
        return StickCourse(self)

    def to_mapping(self) -> dict[str, Any]:
        """Return the law as plain values."""
        return {
            "schema": SCHEMA,
            "networks": [network.to_mapping() for network in self.networks],
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
            return cls(tuple(StickNetwork.from_mapping(one) for one in document["networks"]))
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigError(
                f"no stick law: {error}; make one with: python scripts/fit_slip_law.py"
            ) from error


class StickCourse:
    """Follows a contact with a law, causally."""

    def __init__(self, law: StickLaw) -> None:
        """Start without a contact."""
        self._law = law
        self._said = np.zeros((len(law.networks), OUTPUTS))
        self.reset()

    def reset(self) -> None:
        """Forget the contact: nothing has touched for long."""
        self._memories = [network.untouched for network in self._law.networks]
        self._next_us: list[int] | None = None
        self._stuck = Stuck(1.0, 0.0)

    def update(self, t_us: int, features: Field) -> Stuck:
        """Take in the features ``(FEATURES,)`` of a frame and return the law's output."""
        if self._next_us is None:
            self._next_us = [t_us] * len(self._memories)
        stepped = False
        for number, network in enumerate(self._law.networks):
            if t_us < self._next_us[number]:
                continue
            stepped = True
            self._memories[number], self._said[number] = network(self._memories[number], features)
            self._next_us[number] = max(self._next_us[number] + network.step_us, t_us)
        if stepped:
            self._stuck = Stuck(*self._said.mean(axis=0).tolist())
        return self._stuck


@cache
def fitted_law() -> StickLaw:
    """Return the law that comes with the package."""
    file = importlib.resources.files("spikingtac.touch.slip") / FILE
    return StickLaw.from_mapping(json.loads(file.read_text(encoding="utf-8")))
