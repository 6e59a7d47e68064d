"""The trainer of all small networks (force, contact patch, slip): PyTorch in, ONNX out.

:mod:`spikingtac.touch.network` runs what is exported here.
"""

import tempfile
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from types import MappingProxyType
from typing import Any

import torch

from spikingtac.touch import OPSET, with_record

Loss = Callable[[torch.nn.Module, Any], torch.Tensor]


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """How a network is fitted: by AdamW, its rate in one cycle.

    Attributes:
        rate: Largest learning rate.
        decay: Of the weights.
        epochs: Turns through the samples.
        largest_gradient: Length to which longer gradients are cut.
    """

    rate: float
    decay: float
    epochs: int
    largest_gradient: float = inf


def fit(
    network: torch.nn.Module,
    batches: Callable[[], Sequence[Any]],
    loss: Loss,
    schedule: Schedule,
    report: Callable[[int, float], object] = lambda epoch, mean: None,
) -> None:
    """Fit a network in one thread.

    Args:
        network: The network; left in its state of use.
        batches: Returns the batches of a turn, always as many.
        loss: Loss of the network on one of them.
        schedule: How.
        report: Receives the turn and its mean loss.
    """
    torch.set_num_threads(1)
    turn = batches()
    steps = schedule.epochs * len(turn)
    optimiser = torch.optim.AdamW(network.parameters(), schedule.rate, weight_decay=schedule.decay)
    cycle = torch.optim.lr_scheduler.OneCycleLR(optimiser, schedule.rate, total_steps=steps)
    network.train()
    for epoch in range(schedule.epochs):
        total = 0.0
        for batch in turn:
            value = loss(network, batch)
            optimiser.zero_grad()
            value.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), schedule.largest_gradient)
            optimiser.step()
            cycle.step()
            total += float(value.detach())
        report(epoch, total / len(turn))
        turn = batches() if epoch + 1 < schedule.epochs else turn
    network.eval()


def export(
    network: torch.nn.Module,
    inputs: Mapping[str, torch.Tensor],
    outputs: Iterable[str],
    record: Mapping[str, Any],
    free_axes: Mapping[int, str] = MappingProxyType({0: "n"}),
) -> bytes:
    """Return a network as an ONNX file with its record.

    Args:
        network: The network.
        inputs: Name -> an example of each input.
        outputs: Names of the outputs.
        record: What it was fitted to and what its numbers mean.
        free_axes: Axes of inputs and outputs that may have any length, with a name for each.
    """
    names = list(outputs)
    axes = {name: dict(free_axes) for name in (*inputs, *names)}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter, about itself
        path = Path(folder) / "network.onnx"
        torch.onnx.export(
            network.eval(),
            tuple(inputs.values()),
            str(path),
            input_names=list(inputs),
            output_names=names,
            dynamic_axes=axes,
            opset_version=OPSET,
            dynamo=False,
        )
        content = path.read_bytes()
    return with_record(content, record) if record else content
