"""A scene: a small TOML file that says which sensor is touched, by what, and how it moves."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.schema import build, read_toml, to_mapping
from spikingtac.sim.camera.config import CameraConfig, load_camera
from spikingtac.sim.gel.gel import GelConfig
from spikingtac.sim.gel.indenters import IndenterConfig, make_indenter
from spikingtac.sim.optics.projection import OpticsConfig
from spikingtac.sim.optics.states import SkinState
from spikingtac.sim.scene.motions import Motion, MotionConfig
from spikingtac.sim.scene.variation import VariationConfig


@dataclass(frozen=True, kw_only=True, slots=True)
class SkinConfig:
    """The grid of markers, and which sensor of the series it is.

    Attributes:
        grid: ``(rows, columns)`` of markers (the paper: 8 by 8).
        pitch_mm: Distance between neighbours, mm (the paper gives none; 37 px at 15.5 px/mm).
        serial: Which sensor: its disc tolerances and its camera's pixel mismatch and hot pixels.
            The seed of a recording does not change them, so one calibration fits every seed.
    """

    grid: tuple[int, int] = (8, 8)
    pitch_mm: float = 2.4
    serial: int = 1

    def __post_init__(self) -> None:
        if min(self.grid) < 1:
            raise ValueError(f"grid is {list(self.grid)}, both numbers must be positive")
        if not self.pitch_mm > 0 or self.serial < 0:
            raise ValueError("pitch_mm must be positive and serial must not be negative")

    def rest_mm(self) -> NDArray[np.float64]:
        """Return the nominal places ``(m, 2)`` of the markers, mm, row-major about the axis."""
        rows, columns = self.grid
        y, x = np.mgrid[0:rows, 0:columns].astype(np.float64)
        places = np.stack([x.ravel() - (columns - 1) / 2, y.ravel() - (rows - 1) / 2], axis=1)
        return places * self.pitch_mm

    def at_rest(self) -> SkinState:
        """Return the skin that nothing touches, at time zero."""
        rest_mm = self.rest_mm()
        return SkinState(
            t_us=0,
            marker_mm=np.column_stack((rest_mm, np.zeros(len(rest_mm)))),
            gradient=np.tile(np.eye(2), (len(rest_mm), 1, 1)),
            force_n=np.zeros(3),
            torque_n_mm=np.zeros(3),
            pose_mm=np.full(3, np.nan),
            in_contact=False,
        )


_RENDERING = {"steps": {"max_us": 4000.0}}
"""Slow markers need no finer steps than the gel's: the events are the same (within 1e-5 of their
number in `finger-presses` and `comb-slides`), in half of the time."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraChoice:
    """Which camera preset films the skin, and what differs from it.

    Attributes:
        preset: ``clean``, ``typical`` or ``noisy``, or the path of a camera's TOML file.
        settings: Tables like those of a camera file, laid over the preset.
    """

    preset: str = "typical"
    settings: dict[str, Any] = field(default_factory=dict)

    def resolve(self, size: tuple[int, int]) -> CameraConfig:
        """Return the camera with its settings, for a sensor of ``size``.

        Raises:
            ConfigError: The preset or a setting is unknown or out of range.
        """
        preset = _laid_over(to_mapping(load_camera(self.preset)), _RENDERING)
        return build(CameraConfig, _laid_over(preset, self.settings) | {"size": size}, "camera")


@dataclass(frozen=True, kw_only=True, slots=True)
class HistoryConfig:
    """What the sensor has been through when the recording starts; it is simulated, not recorded.

    A pixel's reference is whatever its last event left, so no sensor in use has fresh ones. The
    history reaches the camera only: the gel starts relaxed, so that the markers start at rest.

    Attributes:
        references: Before the drag: ``rested`` for minutes, so that the leak has moved each
            reference by an unknown part of a threshold; ``random``, as arbitrary motions leave
            them; ``fresh``, each exact, as no real sensor's are (for tests of the camera).
        slide_mm: How far the whole skin was then dragged, in a direction drawn from the seed, and
            let go, mm; 0 is not at all.
        duration_s: How long it took to drag it and let it go, s.
        wait_s: Time from there to the start of the recording, s; the leak goes on meanwhile.
    """

    references: Literal["rested", "random", "fresh"] = "rested"
    wait_s: float = 1.0
    slide_mm: float = 0.3
    duration_s: float = 0.3

    def __post_init__(self) -> None:
        if self.wait_s < 0 or self.slide_mm < 0 or not self.duration_s > 0:
            raise ValueError("wait_s and slide_mm must not be negative, duration_s be positive")


@dataclass(frozen=True, kw_only=True, slots=True)
class ContactConfig:
    """One body that comes, touches and leaves; once or several times.

    Attributes:
        indenter: The body.
        motion: What it does, from clear of the skin to clear of the skin.
        repeats: How many times.
        pause_s: Wait after each time, s.
    """

    indenter: IndenterConfig = field(default_factory=IndenterConfig)
    motion: MotionConfig
    repeats: int = 1
    pause_s: float = 0.0

    def __post_init__(self) -> None:
        make_indenter(self.indenter)
        motion = Motion(self.motion)
        if self.repeats < 1 or self.pause_s < 0:
            raise ValueError("repeats must be at least 1 and pause_s must not be negative")
        if not self.motion.segments or max(motion.pose(at).position_mm[2] for at in
                                           (0.0, motion.duration_s)) >= 0:  # fmt: skip
            raise ValueError(
                "a contact starts clear of the skin (height_mm > 0) and ends clear of it; "
                "let its last segment be a lift or a release"
            )


@dataclass(frozen=True, kw_only=True, slots=True)
class Scene:
    """What happens to which sensor, and what the seed varies.

    Attributes:
        about: One line for the catalogue.
        lead_in_s: MissingMarkers before the first contact, s.
        lead_out_s: Time after the last motion has ended, s (the return metrics are taken there).
        duration_s: Length of a scene without contacts, s.
        mechanics_hz: Lowest rate of the gel's steps; the camera interpolates between them.
        skin: The markers.
        gel: The gel's mechanics.
        optics: The lens, the sensor's size and the discs.
        camera: The event camera.
        history: What came before.
        variation: What the seed changes.
        contacts: What touches the skin, in order.
    """

    about: str = ""
    lead_in_s: float = 0.5
    lead_out_s: float = 1.0
    duration_s: float = 3.0
    mechanics_hz: float = 250.0
    skin: SkinConfig = field(default_factory=SkinConfig)
    gel: GelConfig = field(default_factory=GelConfig)
    optics: OpticsConfig = field(default_factory=OpticsConfig)
    camera: CameraChoice = field(default_factory=CameraChoice)
    history: HistoryConfig = field(default_factory=HistoryConfig)
    variation: VariationConfig = field(default_factory=VariationConfig)
    contacts: tuple[ContactConfig, ...] = ()

    def __post_init__(self) -> None:
        if self.lead_in_s < 0 or self.lead_out_s < 0 or not self.duration_s > 0:
            raise ValueError("lead_in_s and lead_out_s must not be negative, duration_s positive")
        if not 50 <= self.mechanics_hz <= 2000:
            raise ValueError(f"mechanics_hz is {self.mechanics_hz}, valid are 50 to 2000")
        markers = self.skin.grid[0] * self.skin.grid[1]
        for index in (*self.optics.discs.broken, *self.optics.discs.missing):
            if not 0 <= index < markers:
                raise ValueError(f"marker {index} does not exist, valid are 0 to {markers - 1}")
        self.camera.resolve(self.optics.size)

    @property
    def size(self) -> tuple[int, int]:
        """``(width, height)`` of the sensor, px."""
        return self.optics.size

    def with_camera(self, preset: str | None) -> Scene:
        """Return the scene filmed by another preset; its own settings stay laid over it."""
        return self if preset is None else replace(self, camera=replace(self.camera, preset=preset))

    def with_serial(self, serial: int | None) -> Scene:
        """Return the scene on another sensor of the series; None is the same one."""
        return self if serial is None else replace(self, skin=replace(self.skin, serial=serial))

    def resolved(self) -> dict[str, Any]:
        """Return every value behind the scene, the camera's preset spelled out."""
        camera = to_mapping(self.camera.resolve(self.size))
        return to_mapping(self) | {"camera": {"preset": self.camera.preset, "settings": camera}}

    def digest(self) -> str:
        """Return the sha256 of :meth:`resolved`, as hexadecimal digits."""
        text = json.dumps(self.resolved(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


def load_scene(path: str | Path) -> Scene:
    """Read a scene from a TOML file.

    Raises:
        ConfigError: The file cannot be read, or a key or value does not fit; names the key and
            what is valid.
    """
    return build(Scene, read_toml(path), str(path))


def _laid_over(base: Mapping[str, Any], top: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in top.items():
        below = merged.get(key)
        nested = isinstance(below, Mapping) and isinstance(value, Mapping)
        merged[key] = _laid_over(below, value) if nested else value  # type: ignore[arg-type]
    return merged
