"""Weights and optimiser state on disk, as safetensors: tensors and text, no code."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from spikingtac.errors import ConfigError, MissingExtraError
from spikingtac.schema import to_mapping
from spikingtac_paper.training.architecture import NetworkConfig

FORMAT = "spikingtac-denoiser-1"  # Format name in the metadata of a weight file.
_MOMENTS = ("exp_avg", "exp_avg_sq", "step")


@dataclass
class TrainingState:
    """State of a run that is needed to resume it.

    Attributes:
        network: The network.
        optimiser: Adam over its parameters.
        round: Number of completed rounds.
    """

    network: nn.Module
    optimiser: torch.optim.Adam
    round: int = 0


def save_weights(path: str | Path, network: nn.Module, config: NetworkConfig) -> None:
    """Write the weights, with the network's configuration in the metadata."""
    tensors = {name: value.detach().cpu() for name, value in network.state_dict().items()}
    _save(Path(path), tensors, {"network": json.dumps(to_mapping(config))})


def save_state(path: str | Path, state: TrainingState) -> None:
    """Write network and optimiser. An interrupted write leaves the old file."""
    tensors = {f"network.{k}": v.detach().cpu() for k, v in state.network.state_dict().items()}
    for index, moments in state.optimiser.state_dict()["state"].items():
        tensors |= {f"optimiser.{index}.{name}": moments[name].cpu() for name in _MOMENTS}
    _save(Path(path), tensors, {"round": str(state.round)})


def load_state(path: str | Path, state: TrainingState) -> None:
    """Read a state from a file into a new state.

    Raises:
        ConfigError: The file is not such a file, is damaged, or belongs to another network.
    """
    tensors, about = _load(Path(path))
    weights = {name[8:]: value for name, value in tensors.items() if name.startswith("network.")}
    _check_shapes(state.network.state_dict(), weights, str(path))
    state.network.load_state_dict(weights)
    moments: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        if name.startswith("optimiser."):
            _, index, kind = name.split(".")
            moments.setdefault(int(index), {})[kind] = value
    whole: dict[str, Any] = state.optimiser.state_dict()
    state.optimiser.load_state_dict({**whole, "state": moments})
    state.round = int(about.get("round", "0"))


def _check_shapes(wanted: dict[str, Tensor], given: dict[str, Tensor], where: str) -> None:
    for name in sorted({*wanted, *given}):
        if name not in given or name not in wanted:
            kind = "lacks" if name not in given else "has an unknown"
            raise ConfigError(f"{where!r} {kind} tensor {name!r}; it is for another network")
        if wanted[name].shape != given[name].shape:
            raise ConfigError(
                f"{where!r}: tensor {name!r} has shape {tuple(given[name].shape)}, the network "
                f"asks for {tuple(wanted[name].shape)}; use the configuration it was trained with"
            )


def _save(path: Path, tensors: dict[str, Tensor], about: dict[str, str]) -> None:
    _, save_file = _safetensors()
    unfinished = path.with_suffix(".part")
    kept = {name: value.contiguous() for name, value in tensors.items()}
    save_file(kept, unfinished, {"format": FORMAT, **about})
    os.replace(unfinished, path)


def _load(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    safe_open, _ = _safetensors()
    try:
        with safe_open(path, framework="pt") as file:
            about = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except Exception as error:  # the library raises its own class, OSError or ValueError
        raise ConfigError(f"{str(path)!r} is no readable safetensors file: {error}") from error
    if about.get("format") != FORMAT:
        raise ConfigError(f"{str(path)!r} holds no weights of this package's denoiser")
    return tensors, about


def _safetensors() -> tuple[Any, Any]:
    try:
        from safetensors import safe_open
        from safetensors.torch import save_file
    except ImportError as error:
        raise MissingExtraError(
            "training needs safetensors; install it with: pip install 'spikingtac[train]'"
        ) from error
    return safe_open, save_file
