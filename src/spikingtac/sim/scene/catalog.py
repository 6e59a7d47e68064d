"""The scenes of the package, by name."""

from __future__ import annotations

import importlib.resources
import os
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING

from spikingtac.errors import ConfigError, nearest
from spikingtac.schema import read_toml

if TYPE_CHECKING:
    from spikingtac.sim.scene.scene import Scene

# The ten contact trajectories of the point-tracking experiment (§V-A); the seventh is the one of
# localised circular finger motions, as in the paper.
TRAJECTORIES = (
    "finger-presses",
    "finger-slides",
    "finger-torsion",
    "spoon-rubs",
    "comb-slides",
    "spoon-circles",
    "finger-circles",
    "drag-release",
    "finger-rolls",
    "mixed",
)


def scene_names() -> tuple[str, ...]:
    """Return the names of all scenes: the ten trajectories first, then the others sorted."""
    stored = sorted(path.name for path in _folder().iterdir() if path.name.endswith(".toml"))
    rest = (name.removesuffix(".toml") for name in stored)
    return (*TRAJECTORIES, *(name for name in rest if name not in TRAJECTORIES))


def scene_descriptions() -> dict[str, str]:
    """Return the description of each scene by name, without building any scene."""
    return {name: str(read_toml(_path(name)).get("about", "")) for name in scene_names()}


def load_scene(name: str | Path) -> Scene:
    """Return a scene by name, or from a TOML file.

    Args:
        name: Name of a scene, or path of a TOML file.

    Example:
        >>> load_scene("quiet").duration_s
        3.0

    Raises:
        ConfigError: No such name or file exists, or the file does not fit. The message names the
            nearest scene, or the key and its valid values.
    """
    from spikingtac.sim.scene.scene import read_scene  # with the gel's kernels behind it

    text = str(name)
    if text in scene_names():
        return read_scene(_path(text))
    if not text.endswith(".toml") and os.sep not in text:
        raise ConfigError(
            f"no scene {text!r}{nearest(text, scene_names())} "
            f"(valid: {', '.join(scene_names())}, or the path of a TOML file)"
        )
    return read_scene(name)


def _path(name: str) -> Path:
    return Path(str(_folder() / f"{name}.toml"))


def _folder() -> Traversable:
    return importlib.resources.files("spikingtac") / "configs" / "scenes"


load, names, descriptions = load_scene, scene_names, scene_descriptions
