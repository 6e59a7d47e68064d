"""Train a denoiser on recordings with PyTorch, and export it; needs the extra ``[train]``.

The folder of a run holds ``config.json``, ``log.jsonl``, ``state.safetensors`` (to resume) and
``weights.safetensors``. A round draws its degradations, crops and flips from (seed, round) alone,
so that a resumed run gives the same weights as an uninterrupted one. The ``truth.npz`` of a
recording is never opened.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.random import Generator
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from spikingtac.atomic_files import replacing
from spikingtac.denoise import FORMAT
from spikingtac.errors import ConfigError
from spikingtac.schema import build, read_toml, stored_file, to_mapping
from spikingtac_paper.training.architecture import (
    FOLD,
    MULTIPLE_PX,
    NetworkKind,
    apply_network,
    make_network,
)
from spikingtac_paper.training.dataset import LEVELS, Clip, Pairs, load_clip, make_pairs, map_after
from spikingtac_paper.training.export import export_network

Advance = Callable[[float], None]  # Is called with the fraction of the work that is done, 0 to 1.

# Clips to train on, and clips of a motion that is not trained on.
TrainingSet = tuple[list[Clip], list[Clip]]
CONFIGS = ("lean", "evflownet")  # Configurations of the package, under ``configs``.

# Seed, besides the run's, of the maps on which the int8 ranges are measured.
CALIBRATION_SEED = 1 << 21
CALIBRATION_MAPS = 128  # Number of these maps: few of a hundred are noisy enough to set the ranges.
HELD_OUT_SEED = 1 << 20  # Second seed of the held-out pairs; no round has this number.

# Rounds between two evaluations of the held-out loss, which take as long as a dozen steps.
HELD_OUT_EVERY = 5

# Scenes of the twin that are rendered where no recordings are given: slides, whose last map is the
# first of the others; motions, each with some seeds; and one whose loss is logged only.
BOOTSTRAP, HELD_OUT = "bootstrap", "train-torsion"
SCENES = ("train-presses", "train-slides", "train-circles", "train-drag", "train-rubs")
SCENE_SEEDS = (1, 2)
THREADS = 1  # Threads of the CPU; equal seeds give equal weights with one.
CONFIG_FILE, LOG_FILE = "config.json", "log.jsonl"
STATE_FILE, WEIGHTS_FILE = "state.safetensors", "weights.safetensors"
MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # What the optimiser knows of each parameter.


@dataclass(frozen=True, kw_only=True, slots=True)
class TrainConfig:
    """Settings of a training run.

    Attributes:
        moments: Number of moments of each recording in one round.
        network: ``lean`` or ``evflownet`` (as the paper names it).
        seed: Seed of weights, degradations and crops.
        rounds: Number of times that each recording is degraded anew.
        steps: Steps of the optimiser in each round.
        batch: Crops in each step.
        crop_px: Side of a crop, px; a multiple of 16.
        learning_rate: Initial learning rate; it decreases to zero along half a cosine.
        device: ``cpu`` or ``cuda``.
    """

    moments: int = 32
    network: NetworkKind = "lean"
    seed: int = 1
    rounds: int = 60
    steps: int = 40
    batch: int = 24
    crop_px: int = 160
    learning_rate: float = 2e-3
    device: str = "cpu"

    def __post_init__(self) -> None:
        if min(self.moments, self.rounds, self.steps, self.batch) < 1 or self.seed < 0:
            raise ValueError("moments, rounds, steps and batch must be positive, seed not negative")
        if self.crop_px < 1 or self.crop_px % MULTIPLE_PX:
            raise ValueError(f"crop_px is {self.crop_px}, it must be a multiple of {MULTIPLE_PX}")
        if not self.learning_rate > 0:
            raise ValueError(f"learning_rate is {self.learning_rate}, it must be positive")


def load_training_config(name: str, **changes: Any) -> TrainConfig:
    """Load a configuration by name, or from a TOML file.

    Args:
        name: One of :data:`CONFIGS`, or the path of a TOML file.
        changes: Fields to change; a value of None changes nothing.

    Raises:
        ConfigError: It does not exist, or it has an unknown key or an invalid value.
    """
    folder = Path(str(resources.files("spikingtac_paper") / "configs"))
    path = stored_file(name, folder, CONFIGS, "training configuration")
    config = build(TrainConfig, read_toml(path), path.name)
    try:
        return replace(
            config, **{key: value for key, value in changes.items() if value is not None}
        )
    except ValueError as error:
        raise ConfigError(str(error)) from error


def from_scenes(record: Callable[[str, int], Path], advance: Advance) -> TrainingSet:
    """Read the recordings of :data:`SCENES`.

    Args:
        record: Returns the recording of a scene and a seed; it renders the scene first if needed.
        advance: Is called with the fraction that is done, 0 to 1.
    """
    jobs = [*product(SCENES, SCENE_SEEDS), (HELD_OUT, SCENE_SEEDS[0])]
    start, clips = map_after(load_clip(record(BOOTSTRAP, SCENE_SEEDS[0]))), []
    for number, job in enumerate(jobs, 2):
        clips.append(load_clip(record(*job), start))
        advance(number / (len(jobs) + 1))
    return clips[:-1], clips[-1:]


def from_recordings(
    recordings: Sequence[str | Path], bootstrap: str | Path | None = None
) -> TrainingSet:
    """Read recordings of a sensor.

    Args:
        recordings: Recording folders or event files.
        bootstrap: Recording of slides whose last map is the first map of the others.
    """
    start = map_after(load_clip(bootstrap)) if bootstrap else None
    return [load_clip(path, start) for path in recordings], []


def train_and_export(
    config: TrainConfig, recordings: TrainingSet, folder: Path, advance: Advance
) -> dict[str, Any]:
    """Train, or continue a training; write the networks, and return a summary.

    Args:
        config: The training configuration.
        recordings: What to train on.
        folder: Folder of the run.
        advance: Is called with the fraction that is done, 0 to 1.
    """
    network = train(*recordings, config, folder, advance)
    random = np.random.default_rng([config.seed, CALIBRATION_SEED])
    pairs = _whole_blocks(make_pairs(recordings[0], config.moments, random))
    count = len(pairs.inputs)
    chosen = random.choice(count, min(CALIBRATION_MAPS, count), replace=False)
    plain, int8 = export_network(network, config.network, folder, _levels(pairs.inputs[chosen]))
    lines = (folder / LOG_FILE).read_text(encoding="utf-8").splitlines()
    return {
        "rounds": config.rounds,
        **{key: value for key, value in json.loads(lines[-1]).items() if key != "round"},
        "weights": str(folder / WEIGHTS_FILE),
        "onnx": str(plain),
        "int8": str(int8 or plain),
    }


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
    folder: Path,
    advance: Advance = lambda fraction: None,
) -> nn.Module:
    """Train a network, or resume the run in the folder; write its weights, and return it.

    Args:
        clips: Training recordings of one sensor size.
        held_out: Recordings for the held-out loss; may be empty.
        config: Settings. A folder with other settings is refused.
        folder: Folder of the run.
        advance: Receives the completed fraction, 0 to 1.

    Raises:
        ConfigError: There is no recording, the sizes differ or are smaller than a crop, the folder
            holds another run, or the device does not exist.
    """
    _check(clips, config)
    run = _Run(config, folder)
    check_pairs = None
    if held_out:
        random = np.random.default_rng([config.seed, HELD_OUT_SEED])
        check_pairs = _whole_blocks(make_pairs(held_out, config.moments, random))
    for number in range(run.rounds, config.rounds):
        line = run.round(clips, number)
        if check_pairs is not None and (number + 1) % HELD_OUT_EVERY == 0:
            line["held_out"] = run.loss_on(check_pairs)
        run.finish(number + 1, line)
        advance((number + 1) / config.rounds)
    _save(folder / WEIGHTS_FILE, run.network.state_dict(), {"network": config.network})
    return run.network


def forget_run(folder: Path) -> None:
    """Remove a run, so that the folder can take another; what else is in the folder stays."""
    for name in (STATE_FILE, LOG_FILE, WEIGHTS_FILE, CONFIG_FILE):
        (folder / name).unlink(missing_ok=True)


class _Run:
    def __init__(self, config: TrainConfig, folder: Path) -> None:
        torch.set_num_threads(THREADS)
        torch.manual_seed(config.seed)
        self.config, self.folder = config, folder
        self.network = make_network(config.network).to(config.device)
        self.optimiser = torch.optim.Adam(self.network.parameters(), lr=config.learning_rate)
        self.rounds = 0
        folder.mkdir(parents=True, exist_ok=True)
        _claim(folder / CONFIG_FILE, config)
        if (folder / STATE_FILE).is_file():
            self._resume(folder / STATE_FILE)

    def round(self, clips: Sequence[Clip], number: int) -> dict[str, float]:
        config = self.config
        random = np.random.default_rng([config.seed, number])
        pairs = make_pairs(clips, config.moments, random)
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
        logits = apply_network(self.network, inputs.to(config.device), FOLD[config.network])
        loss = prediction_error(logits, targets.to(config.device))
        loss.backward()
        self.optimiser.step()
        return float(loss.detach())

    @torch.no_grad()
    def loss_on(self, pairs: Pairs) -> float:
        config = self.config
        total = 0.0
        for first in range(0, len(pairs.inputs), config.batch):
            chosen = slice(first, first + config.batch)
            inputs = _levels(pairs.inputs[chosen]).to(config.device)
            logits = apply_network(self.network, inputs, FOLD[config.network])
            target = _levels(pairs.targets[chosen]).to(config.device)
            total += float(prediction_error(logits, target)) * len(inputs)
        return total / len(pairs.inputs)

    def finish(self, rounds: int, line: dict[str, float]) -> None:
        tensors = {"rounds": torch.tensor(rounds), **self.network.state_dict()}
        for index, moments in self.optimiser.state_dict()["state"].items():
            tensors |= {f"{index}.{name}": moments[name] for name in MOMENTS}
        _save(self.folder / STATE_FILE, tensors, {})
        with (self.folder / LOG_FILE).open("a", encoding="utf-8") as log:
            log.write(json.dumps({"round": rounds, **line}) + "\n")

    def _resume(self, path: Path) -> None:
        try:
            tensors = load_file(path)
            self.rounds = int(tensors["rounds"])
            self.network.load_state_dict({key: tensors[key] for key in self.network.state_dict()})
            moments = {
                index: {name: tensors[f"{index}.{name}"] for name in MOMENTS}
                for index, _ in enumerate(self.network.parameters())
            }
        except Exception as error:  # the library raises its own class, OSError or ValueError
            raise ConfigError(f"{str(path)!r} holds no state of this run: {error}") from error
        self.optimiser.load_state_dict({**self.optimiser.state_dict(), "state": moments})


def _save(path: Path, tensors: dict[str, Tensor], about: dict[str, str]) -> None:
    """Write tensors and metadata as safetensors; an interrupted write leaves the old file."""
    plain = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    with replacing(path) as partial:
        save_file(plain, partial, {"format": FORMAT, **about})


def _levels(maps: np.ndarray) -> Tensor:
    return torch.from_numpy(maps[:, None].astype(np.float32) / np.float32(LEVELS))


def _crops(pairs: Pairs, config: TrainConfig, random: Generator) -> tuple[Tensor, Tensor]:
    """Cut one batch at random places, randomly flipped and rotated: markers have no direction."""
    side = config.crop_px
    _, height, width = pairs.inputs.shape
    inputs = np.empty((config.batch, side, side), np.uint8)
    targets = np.empty_like(inputs)
    for index in range(config.batch):
        item = random.integers(len(pairs.inputs))
        top, left = random.integers(height - side + 1), random.integers(width - side + 1)
        turns, flipped = int(random.integers(4)), int(random.integers(2))
        for source, out in ((pairs.inputs, inputs), (pairs.targets, targets)):
            cropped = np.rot90(source[item, top : top + side, left : left + side], turns)
            out[index] = cropped[::-1] if flipped else cropped
    return _levels(inputs), _levels(targets)


def _whole_blocks(pairs: Pairs) -> Pairs:
    """Return the pairs without what is left of their sides beyond whole blocks of the network."""
    rows, columns = (side // MULTIPLE_PX * MULTIPLE_PX for side in pairs.inputs.shape[1:])
    return Pairs(*(maps[:, :rows, :columns] for maps in pairs))


def _check(clips: Sequence[Clip], config: TrainConfig) -> None:
    if not clips:
        raise ConfigError("there is no recording to train on; give recordings")
    sizes = {clip.events.size for clip in clips}
    if len(sizes) > 1:
        raise ConfigError(f"the recordings differ in size: {sorted(sizes)}; train on one sensor")
    if min(*sizes.pop()) < config.crop_px:
        raise ConfigError(f"the sensor is smaller than crop_px, {config.crop_px}; lower it")
    cuda = config.device.startswith("cuda") and torch.cuda.is_available()
    if not cuda and config.device != "cpu":
        raise ConfigError(f"there is no device {config.device!r} here (valid: cpu, cuda)")


def _claim(path: Path, config: TrainConfig) -> None:
    text = json.dumps(to_mapping(config), indent=1, sort_keys=True)
    if path.is_file() and path.read_text(encoding="utf-8") != text:
        raise ConfigError(
            f"{str(path.parent)!r} holds a run with other settings; choose another folder"
        )
    path.write_text(text, encoding="utf-8")
