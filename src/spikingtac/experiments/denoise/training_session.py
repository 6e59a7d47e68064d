"""One training run from its configuration to exported networks; needs the extra ``[train]``."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.denoise.network.export import export_network
from spikingtac.denoise.training.dataset import LEVELS, make_pairs
from spikingtac.denoise.training.train import LOG_FILE, TrainConfig, train
from spikingtac.errors import ConfigError, nearest
from spikingtac.experiments.denoise.training_recordings import (
    TrainingSet,
    from_recordings,
    from_scenes,
)
from spikingtac.schema import build, read_toml

CONFIGS = ("lean", "evflownet")
"""Configurations that come with the package, under ``configs/training``."""
RECORDINGS = "recordings"
"""Folder of a run that keeps the rendered scenes."""
CALIBRATION_SEED = 1 << 21
"""Seed, beside the run's, of the maps that the int8 ranges are measured on."""
CALIBRATION_MAPS = 128
"""How many such maps: the noisiest ones, which reach farthest, are a few in a hundred."""


@dataclass(frozen=True, slots=True)
class Prepared:
    """A configuration and the recordings that it is trained on."""

    config: TrainConfig
    recordings: TrainingSet


def load_training_config(name: str) -> TrainConfig:
    """Load a configuration by name, or from a TOML file.

    Raises:
        ConfigError: There is neither, or the file holds an unknown key or an unfit value.
    """
    if name in CONFIGS:
        stored = resources.files("spikingtac") / "configs" / "training" / f"{name}.toml"
        with resources.as_file(stored) as path:
            return build(TrainConfig, read_toml(path), f"training configuration {name}")
    if not name.endswith(".toml"):
        raise ConfigError(
            f"unknown training configuration {name!r}{nearest(name, CONFIGS)} "
            f"(valid: {', '.join(CONFIGS)}, or the path of a .toml file)"
        )
    return build(TrainConfig, read_toml(name), Path(name).name)


def prepare(
    name: str,
    folder: Path,
    recordings: Sequence[Path],
    bootstrap: Path | None,
    given: Mapping[str, Any],
    advance: Callable[[float], None],
) -> Prepared:
    """Load the configuration and the recordings; scenes are rendered where none are given.

    Args:
        name: See :func:`load_training_config`.
        folder: Folder of the run.
        recordings: Recordings to train on instead of scenes.
        bootstrap: Recording that shows every marker, for ``recordings``.
        given: Fields of the configuration to change; None changes nothing.
        advance: Told the share that is done, 0 to 1.
    """
    changes = {key: value for key, value in given.items() if value is not None}
    try:
        config = dataclasses.replace(load_training_config(name), **changes)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    if recordings:
        return Prepared(config, from_recordings(recordings, bootstrap))
    rendered = from_scenes(
        config.scenes,
        config.seeds,
        folder / RECORDINGS,
        held_out=config.held_out,
        bootstrap=config.bootstrap,
        advance=advance,
    )
    return Prepared(config, rendered)


def train_and_export(
    prepared: Prepared, folder: Path, advance: Callable[[float], None]
) -> dict[str, Any]:
    """Train or go on, write the networks, and return a summary."""
    config, recordings = prepared.config, prepared.recordings
    weights = train(recordings.clips, recordings.held_out, config, folder, advance)
    random = np.random.default_rng([config.seed, CALIBRATION_SEED])
    inputs = make_pairs(recordings.clips, config.pairs, random).inputs
    chosen = random.choice(len(inputs), min(CALIBRATION_MAPS, len(inputs)), replace=False)
    maps = [inputs[index].astype(np.float32) / np.float32(LEVELS) for index in chosen]
    plain, int8 = export_network(weights, folder, maps, config.network.kind)
    lines = (folder / LOG_FILE).read_text(encoding="utf-8").splitlines()
    return {
        "rounds": config.rounds,
        **{key: value for key, value in json.loads(lines[-1]).items() if key != "round"},
        "weights": str(weights),
        "onnx": str(plain),
        "int8": str(int8),
    }
