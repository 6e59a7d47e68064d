"""A training run, from its configuration to exported networks; it needs the extra ``[train]``.

Recordings of the twin contain ``truth.npz`` as every simulation does; training never opens it.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.errors import ConfigError, nearest
from spikingtac.schema import build, read_toml
from spikingtac_paper.training.dataset import LEVELS, Clip, load_clip, make_pairs, map_after
from spikingtac_paper.training.export import export_network
from spikingtac_paper.training.train import LOG_FILE, TrainConfig, train

Advance = Callable[[float], None]  # Is called with the fraction of the work that is done, 0 to 1.

# Returns the recording of a scene and a seed; it renders the scene first if needed.
SceneRecorder = Callable[[str, int], Path]

# Clips to train on, and clips of a motion that is not trained on.
TrainingSet = tuple[list[Clip], list[Clip]]
CONFIGS = ("lean", "evflownet")  # Configurations of the package, under ``configs``.

# Seed, besides the run's, of the maps on which the int8 ranges are measured.
CALIBRATION_SEED = 1 << 21
CALIBRATION_MAPS = 128  # Number of these maps: few of a hundred are noisy enough to set the ranges.


def load_training_config(name: str, **changes: Any) -> TrainConfig:
    """Load a configuration by name, or from a TOML file.

    Args:
        name: One of :data:`CONFIGS`, or the path of a TOML file.
        changes: Fields to change; a value of None changes nothing.

    Raises:
        ConfigError: It does not exist, or it has an unknown key or an invalid value.
    """
    if name in CONFIGS:
        stored = resources.files("spikingtac_paper") / "configs" / f"{name}.toml"
        with resources.as_file(stored) as path:
            config = build(TrainConfig, read_toml(path), f"training configuration {name}")
    elif name.endswith(".toml"):
        config = build(TrainConfig, read_toml(name), Path(name).name)
    else:
        raise ConfigError(
            f"unknown training configuration {name!r}{nearest(name, CONFIGS)} "
            f"(valid: {', '.join(CONFIGS)}, or the path of a .toml file)"
        )
    given = {key: value for key, value in changes.items() if value is not None}
    try:
        return dataclasses.replace(config, **given)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def from_scenes(config: TrainConfig, record: SceneRecorder, advance: Advance) -> TrainingSet:
    """Read the recordings of a configuration's scenes.

    Args:
        config: Names and seeds of the scenes, of the held-out one and of the slides.
        record: Returns the recording of a scene and a seed; it renders the scene first if needed.
        advance: Is called with the fraction that is done, 0 to 1.

    Raises:
        ConfigError: A scene does not exist.
    """
    jobs = [(name, seed) for name in config.scenes for seed in config.seeds]
    first_seed, bootstraps = config.seeds[0], int(bool(config.bootstrap))
    total = len(jobs) + bootstraps + bool(config.held_out)
    start = None
    if config.bootstrap:
        start = map_after(load_clip(record(config.bootstrap, first_seed)))
        advance(1 / total)
    clips = []
    for number, (name, seed) in enumerate(jobs, 1 + bootstraps):
        clips.append(load_clip(record(name, seed), start))
        advance(number / total)
    if not config.held_out:
        return clips, []
    return clips, [load_clip(record(config.held_out, first_seed), start)]


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
    clips, held_out = recordings
    weights = train(clips, held_out, config, folder, advance)
    random = np.random.default_rng([config.seed, CALIBRATION_SEED])
    inputs = make_pairs(clips, config.pairs, random).inputs
    indices = random.choice(len(inputs), min(CALIBRATION_MAPS, len(inputs)), replace=False)
    maps = [inputs[index].astype(np.float32) / np.float32(LEVELS) for index in indices]
    plain, int8 = export_network(weights, folder, maps, config.network.kind)
    lines = (folder / LOG_FILE).read_text(encoding="utf-8").splitlines()
    return {
        "rounds": config.rounds,
        **{key: value for key, value in json.loads(lines[-1]).items() if key != "round"},
        "weights": str(weights),
        "onnx": str(plain),
        "int8": str(int8 or plain),
    }
