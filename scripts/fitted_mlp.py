"""Fits a multilayer perceptron of ``spikingtac.touch.field.mlp`` to views of drawn contacts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf
from typing import TypeVar

import numpy as np
import torch

from spikingtac.touch.field.mlp import Mlp

View = TypeVar("View")


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """How a network is fitted: by AdamW, its rate in one cycle.

    Attributes:
        batch: Views at a time.
        rate: Largest learning rate.
        decay: Of the weights.
        largest_gradient: Length to which longer gradients are cut.
        epochs: Turns through the views.
    """

    batch: int
    rate: float
    decay: float
    largest_gradient: float = inf
    epochs: int


def fitted_mlp(
    sizes: Sequence[int],
    views: Sequence[View],
    loss_of: Callable[[torch.nn.Sequential, list[View]], torch.Tensor],
    schedule: Schedule,
    rng: np.random.Generator,
    report: Callable[[Mlp, float], object],
) -> Mlp:
    """Return the network that fits the views.

    Args:
        sizes: Values of each layer, from the features to the outputs.
        views: What it is fitted to.
        loss_of: Loss of the network on some of them.
        schedule: How.
        rng: Order of the views.
        report: Returns what is printed after a turn, of the network and the mean loss.
    """
    torch.manual_seed(0)
    torch.set_num_threads(1)
    layers = [torch.nn.Linear(a, b) for a, b in pairwise(sizes)]
    bent = [part for layer in layers[:-1] for part in (layer, torch.nn.Tanh())]
    network = torch.nn.Sequential(*bent, layers[-1])
    optimiser = torch.optim.AdamW(network.parameters(), schedule.rate, weight_decay=schedule.decay)
    turns = len(views) // schedule.batch
    cycle = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, schedule.rate, total_steps=schedule.epochs * turns
    )
    for epoch in range(schedule.epochs):
        order, total = rng.permutation(len(views)), 0.0
        for chosen in order[: turns * schedule.batch].reshape(turns, schedule.batch):
            loss = loss_of(network, [views[k] for k in chosen])
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), schedule.largest_gradient)
            optimiser.step()
            cycle.step()
            total += float(loss.detach())
        print(epoch, report(plain(layers), total / turns), flush=True)
    return plain(layers)


def plain(layers: Sequence[torch.nn.Linear]) -> Mlp:
    """Return the layers as arrays."""
    weights = [layer.weight.detach().numpy().astype(float) for layer in layers]
    biases = [layer.bias.detach().numpy().astype(float) for layer in layers]
    return Mlp(tuple(weights), tuple(biases))
