"""Recordings of the digital twin for ``spikingtac train``: rendered once, then read like any other.

The folders hold ``truth.npz`` as every simulation does; training never opens it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from spikingtac.denoise.training.dataset import Clip, load_clip, map_after
from spikingtac.events.recording import MANIFEST
from spikingtac.sim.scene import catalog
from spikingtac.sim.scene.render import simulate


@dataclass(frozen=True, slots=True)
class TrainingSet:
    """What a run trains on, split by recording.

    Attributes:
        clips: Recordings to train on.
        held_out: Recordings of the kind of motion that no pair comes from.
    """

    clips: list[Clip]
    held_out: list[Clip]


def from_scenes(
    scenes: Sequence[str],
    seeds: Sequence[int],
    folder: str | Path,
    *,
    held_out: str = "",
    bootstrap: str = "",
    advance: Callable[[float], None] = lambda share: None,
) -> TrainingSet:
    """Render scenes that are not there yet, and read their events.

    Args:
        scenes: Names of scenes.
        seeds: Seeds of each.
        folder: Where the recordings are kept.
        held_out: Scene to hold out; empty holds none out.
        bootstrap: Scene whose slides paint the map that the others begin with; empty is an empty
            map.
        advance: Told the share that is done, 0 to 1.

    Raises:
        ConfigError: There is no such scene.
    """
    kept = Path(folder)
    jobs = [(name, seed) for name in scenes for seed in seeds]
    total = len(jobs) + bool(held_out) + bool(bootstrap)
    start = None
    if bootstrap:
        start = map_after(load_clip(_recorded(bootstrap, seeds[0], kept)))
        advance(1 / total)
    clips = []
    for number, (name, seed) in enumerate(jobs, 1):
        clips.append(load_clip(_recorded(name, seed, kept), start))
        advance((number + bool(bootstrap)) / total)
    spared = [load_clip(_recorded(held_out, seeds[0], kept), start)] if held_out else []
    return TrainingSet(clips, spared)


def from_recordings(
    recordings: Sequence[str | Path], bootstrap: str | Path | None = None
) -> TrainingSet:
    """Read recordings of a sensor; see :func:`from_scenes` for what the bootstrap does."""
    start = map_after(load_clip(bootstrap)) if bootstrap else None
    return TrainingSet([load_clip(path, start) for path in recordings], [])


def _recorded(name: str, seed: int, folder: Path) -> Path:
    target = folder / f"{name}-{seed}"
    if not (target / MANIFEST).is_file():
        simulate(catalog.load(name), target, seed=seed, overwrite=True)
    return target
