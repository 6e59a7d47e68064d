"""The recordings of a training run, read as clips.

Recordings of the twin contain ``truth.npz`` as every simulation does; training never opens it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from spikingtac_paper.training.dataset import Clip, load_clip, map_after

Advance = Callable[[float], None]
"""Is called with the fraction of the work that is done, 0 to 1."""
SceneRecorder = Callable[[str, int], Path]
"""Returns the recording of a scene and a seed; it renders the scene first if needed."""


@dataclass(frozen=True, slots=True)
class TrainingSet:
    """The clips of a training run, split by recording.

    Attributes:
        clips: Clips to train on.
        held_out: Clips of a motion that is not trained on.
    """

    clips: list[Clip]
    held_out: list[Clip]


@dataclass(frozen=True, kw_only=True, slots=True)
class SceneChoice:
    """The scenes of a training run.

    Attributes:
        scenes: Names of the scenes.
        seeds: Seeds of each scene.
        held_out: Scene to hold out; empty holds out none.
        bootstrap: Scene of slides whose last map is the first map of the others; empty begins with
            an empty map.
    """

    scenes: Sequence[str]
    seeds: Sequence[int]
    held_out: str = ""
    bootstrap: str = ""


def from_scenes(choice: SceneChoice, record: SceneRecorder, advance: Advance) -> TrainingSet:
    """Read the recordings of scenes.

    Args:
        choice: Names and seeds of the scenes.
        record: Returns the recording of a scene.
        advance: Is called with the fraction that is done, 0 to 1.

    Raises:
        ConfigError: A scene does not exist.
    """
    jobs = [(name, seed) for name in choice.scenes for seed in choice.seeds]
    first_seed, bootstraps = choice.seeds[0], int(bool(choice.bootstrap))
    total = len(jobs) + bootstraps + bool(choice.held_out)
    start = None
    if choice.bootstrap:
        start = map_after(load_clip(record(choice.bootstrap, first_seed)))
        advance(1 / total)
    clips = []
    for number, (name, seed) in enumerate(jobs, 1 + bootstraps):
        clips.append(load_clip(record(name, seed), start))
        advance(number / total)
    if not choice.held_out:
        return TrainingSet(clips, [])
    return TrainingSet(clips, [load_clip(record(choice.held_out, first_seed), start)])


def from_recordings(
    recordings: Sequence[str | Path], bootstrap: str | Path | None = None
) -> TrainingSet:
    """Read recordings of a sensor.

    Args:
        recordings: Recording folders or event files.
        bootstrap: Recording of slides whose last map is the first map of the others.
    """
    start = map_after(load_clip(bootstrap)) if bootstrap else None
    return TrainingSet([load_clip(path, start) for path in recordings], [])
