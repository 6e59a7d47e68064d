"""Train a denoiser on recordings with PyTorch. A run can be resumed and logs every round.

The folder of a run holds ``config.json``, ``log.jsonl``, ``state.safetensors`` (to resume) and
``weights.safetensors``. A round draws its degradations, crops and flips from (seed, round) alone,
so that a resumed run gives the same weights as an uninterrupted one.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from numpy.random import Generator
from torch import Tensor

from spikingtac.errors import ConfigError
from spikingtac.schema import to_mapping
from spikingtac_paper.training.architecture import NetworkConfig, apply_network, make_network
from spikingtac_paper.training.dataset import LEVELS, Clip, PairConfig, Pairs, make_pairs
from spikingtac_paper.training.state import TrainingState, load_state, save_state, save_weights

HELD_OUT_SEED = 1 << 20  # Second seed of the held-out pairs; no round has this number.

# Rounds between two evaluations of the held-out loss, which take as long as a dozen steps.
HELD_OUT_EVERY = 5
CONFIG_FILE, LOG_FILE = "config.json", "log.jsonl"
STATE_FILE, WEIGHTS_FILE = "state.safetensors", "weights.safetensors"


@dataclass(frozen=True, kw_only=True, slots=True)
class TrainConfig:
    """Settings of a training run.

    Attributes:
        scenes: Scenes of the digital twin to render and train on, if no recordings are given.
        seeds: Seeds of each scene.
        held_out: Scene without training pairs, whose loss is logged.
        bootstrap: Scene whose slides give the initial map of the others.
        pairs: How recordings become pairs.
        network: Size of the network.
        seed: Seed of weights, degradations and crops.
        rounds: Number of times that each recording is degraded anew.
        steps: Steps of the optimiser in each round.
        batch: Crops in each step.
        crop_px: Side of a crop, px; a multiple of the network's.
        learning_rate: Initial learning rate; it decreases to zero along half a cosine.
        threads: Number of CPU threads.
        device: ``cpu`` or ``cuda``.
    """

    scenes: tuple[str, ...] = ()
    seeds: tuple[int, ...] = (1, 2)
    held_out: str = ""
    bootstrap: str = ""
    pairs: PairConfig = field(default_factory=PairConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    seed: int = 1
    rounds: int = 60
    steps: int = 40
    batch: int = 24
    crop_px: int = 160
    learning_rate: float = 2e-3
    threads: int = 2
    device: str = "cpu"

    def __post_init__(self) -> None:
        if min(self.rounds, self.steps, self.batch, self.threads) < 1 or self.seed < 0:
            raise ValueError("rounds, steps, batch and threads must be positive, seed not negative")
        if self.crop_px < 1 or self.crop_px % self.network.multiple_px:
            raise ValueError(
                f"crop_px is {self.crop_px}, it must be a multiple of {self.network.multiple_px}"
            )
        if not self.learning_rate > 0:
            raise ValueError(f"learning_rate is {self.learning_rate}, it must be positive")


def prediction_error(logits: Tensor, target: Tensor) -> Tensor:
    """Return the cross-entropy between the denoised map and another map of the same moment.

    Its minimum is the expectation of the target for the given input, whatever the noise of the
    target, as long as that noise is independent (J. Lehtinen et al., "Noise2Noise", ICML 2018,
    arXiv:1803.04189). Pixels that only chance connects get the same prediction, so that the network
    cannot copy noise.

    The paper refers to "the loss formulations in NeuTac", of which no publication could be found,
    and EV-FlowNet's needs camera frames: this one is ours (``docs/explanation/denoising.md``).

    Args:
        logits: ``(n, 1, height, width)``.
        target: Same shape, from 0 to 1.
    """
    return torch.nn.functional.binary_cross_entropy_with_logits(logits, target)


def train(
    clips: Sequence[Clip],
    held_out: Sequence[Clip],
    config: TrainConfig,
    folder: str | Path,
    advance: Callable[[float], None] = lambda fraction: None,
) -> Path:
    """Train a network, or resume the run in the folder.

    Args:
        clips: Training recordings of one sensor size.
        held_out: Recordings for the held-out loss; may be empty.
        config: Settings. A folder with other settings is refused.
        folder: Folder of the run.
        advance: Receives the completed fraction, 0 to 1.

    Returns:
        Path of ``weights.safetensors``.

    Raises:
        ConfigError: There is no recording, the sizes differ or are smaller than a crop, the folder
            holds another run, or the device does not exist.
    """
    _check(clips, config)
    run = _Run(config, Path(folder))
    check_pairs = _held_out_pairs(held_out, config)
    for number in range(run.state.round, config.rounds):
        line = run.round(clips, number)
        if check_pairs is not None and (number + 1) % HELD_OUT_EVERY == 0:
            line["held_out"] = run.loss_on(check_pairs)
        run.finish(number + 1, line)
        advance((number + 1) / config.rounds)
    weights = run.folder / WEIGHTS_FILE
    save_weights(weights, run.network, config.network)
    return weights


def forget_run(folder: Path) -> None:
    """Remove a run, so that the folder can take another; what else is in the folder stays."""
    for name in (STATE_FILE, LOG_FILE, WEIGHTS_FILE, CONFIG_FILE):
        (folder / name).unlink(missing_ok=True)


class _Run:
    def __init__(self, config: TrainConfig, folder: Path) -> None:
        torch.set_num_threads(config.threads)
        torch.manual_seed(config.seed)
        self.config, self.folder = config, folder
        self.network = make_network(config.network).to(config.device)
        self.optimiser = torch.optim.Adam(self.network.parameters(), lr=config.learning_rate)
        self.state = TrainingState(self.network, self.optimiser)
        folder.mkdir(parents=True, exist_ok=True)
        _claim(folder / CONFIG_FILE, config)
        if (folder / STATE_FILE).is_file():
            load_state(folder / STATE_FILE, self.state)

    def round(self, clips: Sequence[Clip], number: int) -> dict[str, float]:
        config = self.config
        random = np.random.default_rng([config.seed, number])
        pairs = make_pairs(clips, config.pairs, random)
        loss = 0.0
        for step in range(config.steps):
            done = (number + step / config.steps) / config.rounds
            rate = config.learning_rate * 0.5 * (1.0 + float(np.cos(np.pi * done)))
            for group in self.optimiser.param_groups:
                group["lr"] = rate
            loss += self._step(*_crops(pairs, config, random)) / config.steps
        return {"loss": loss}

    def _step(self, inputs: Tensor, targets: Tensor) -> float:
        config = self.config
        self.optimiser.zero_grad(set_to_none=True)
        logits = apply_network(self.network, inputs.to(config.device), config.network.fold)
        loss = prediction_error(logits, targets.to(config.device))
        loss.backward()
        self.optimiser.step()
        return float(loss.detach())

    @torch.no_grad()
    def loss_on(self, pairs: Pairs) -> float:
        config = self.config
        total = 0.0
        for first in range(0, len(pairs), config.batch):
            chosen = slice(first, first + config.batch)
            inputs = _levels(pairs.inputs[chosen]).to(config.device)
            logits = apply_network(self.network, inputs, config.network.fold)
            target = _levels(pairs.targets[chosen]).to(config.device)
            total += float(prediction_error(logits, target)) * len(inputs)
        return total / len(pairs)

    def finish(self, rounds: int, line: dict[str, float]) -> None:
        self.state.round = rounds
        save_state(self.folder / STATE_FILE, self.state)
        with (self.folder / LOG_FILE).open("a", encoding="utf-8") as log:
            log.write(json.dumps({"round": rounds, **line}) + "\n")


def _levels(maps: np.ndarray) -> Tensor:
    return torch.from_numpy(maps[:, None].astype(np.float32) / np.float32(LEVELS))


def _crops(pairs: Pairs, config: TrainConfig, random: Generator) -> tuple[Tensor, Tensor]:
    """Cut one batch at random places, randomly flipped and rotated: markers have no direction."""
    side = config.crop_px
    _, height, width = pairs.inputs.shape
    inputs = np.empty((config.batch, side, side), np.uint8)
    targets = np.empty_like(inputs)
    for index in range(config.batch):
        item = random.integers(len(pairs))
        top, left = random.integers(height - side + 1), random.integers(width - side + 1)
        turns, flipped = int(random.integers(4)), int(random.integers(2))
        for source, out in ((pairs.inputs, inputs), (pairs.targets, targets)):
            cropped = np.rot90(source[item, top : top + side, left : left + side], turns)
            out[index] = cropped[::-1] if flipped else cropped
    return _levels(inputs), _levels(targets)


def _held_out_pairs(clips: Sequence[Clip], config: TrainConfig) -> Pairs | None:
    if not clips:
        return None
    random = np.random.default_rng([config.seed, HELD_OUT_SEED])
    pairs = make_pairs(clips, config.pairs, random)
    multiple = config.network.multiple_px
    rows, columns = (side // multiple * multiple for side in pairs.inputs.shape[1:])
    return Pairs(pairs.inputs[:, :rows, :columns], pairs.targets[:, :rows, :columns])


def _check(clips: Sequence[Clip], config: TrainConfig) -> None:
    if not clips:
        raise ConfigError("there is no recording to train on; give recordings, or name scenes")
    sizes = {clip.events.size for clip in clips}
    if len(sizes) > 1:
        raise ConfigError(f"the recordings differ in size: {sorted(sizes)}; train on one sensor")
    if min(*sizes.pop()) < config.crop_px:
        raise ConfigError(f"the sensor is smaller than crop_px, {config.crop_px}; lower it")
    if config.device.startswith("cuda") and not torch.cuda.is_available():
        raise ConfigError("no CUDA device was found; use device = 'cpu'")


def _claim(path: Path, config: TrainConfig) -> None:
    text = json.dumps(to_mapping(config), indent=1, sort_keys=True)
    if path.is_file() and path.read_text(encoding="utf-8") != text:
        raise ConfigError(
            f"{str(path.parent)!r} holds a run with other settings; choose another folder"
        )
    path.write_text(text, encoding="utf-8")
