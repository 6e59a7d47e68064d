"""The scenes of the package, by name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from spikingtac.schema import from_toml, read_toml, stored_file
from spikingtac.sim.camera.config import CONFIGS

if TYPE_CHECKING:
    from spikingtac.sim.scene import Scene

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
    stored = sorted(path.stem for path in (CONFIGS / "scenes").glob("*.toml"))
    return (*TRAJECTORIES, *(name for name in stored if name not in TRAJECTORIES))


def scene_descriptions() -> dict[str, str]:
    """Return the description of each scene by name, without building any scene."""
    files = {name: CONFIGS / "scenes" / f"{name}.toml" for name in scene_names()}
    return {name: str(read_toml(path).get("about", "")) for name, path in files.items()}


def load_scene(name: str | Path) -> Scene:
    """Return a scene by name, or from a TOML file.

    Args:
        name: Name of a scene, or path of a TOML file.

    Example:
        >>> load_scene("gelsight-7x10").size
        (320, 240)

    Raises:
        ConfigError: No such name or file exists, or the file does not fit. The message names the
            nearest scene, or the key and its valid values.
    """
    from spikingtac.sim.scene import Scene  # with the gel's kernels behind it

    return from_toml(Scene, stored_file(name, CONFIGS / "scenes", scene_names(), "scene"))
