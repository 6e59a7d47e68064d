"""A scene: a TOML file that gives the sensor, the bodies that touch it and their motions."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from spikingtac.schema import build, merged, require_within, to_mapping
from spikingtac.sim.camera.config import CameraConfig, load_camera
from spikingtac.sim.gel import GelConfig
from spikingtac.sim.indenters import IndenterConfig, make_indenter
from spikingtac.sim.motions import IndenterMotion, MotionConfig
from spikingtac.sim.optics import OpticsConfig, SkinState
from spikingtac.types import FloatArray


@dataclass(frozen=True, kw_only=True, slots=True)
class SkinConfig:
    """The grid of markers, and the number of the individual sensor.

    Attributes:
        grid: ``(rows, columns)`` of markers (the paper: 8 by 8).
        pitch_mm: Distance between neighbours, mm (not in the paper; 37 px at 15.5 px/mm).
        serial: Number of the individual sensor. It fixes the disc tolerances, the mismatch of the
            pixels and the hot pixels. The seed of a recording does not change them, so that one
            calibration fits every seed.
    """

    grid: tuple[int, int] = (8, 8)
    pitch_mm: float = 2.4
    serial: int = 1

    def __post_init__(self) -> None:
        if min(self.grid) < 1 or self.grid[0] * self.grid[1] > MOST_MARKERS:
            raise ValueError(f"grid is {list(self.grid)}, valid are 1 to {MOST_MARKERS} markers")
        require_within(self, pitch_mm=(0.01, 1e3), serial=(0, 1 << 32))

    def rest_mm(self) -> FloatArray:
        """Return the nominal places ``(m, 2)`` of the markers, mm, row-major about the axis."""
        rows, columns = self.grid
        y, x = np.mgrid[0:rows, 0:columns].astype(np.float64)
        places = np.stack([x.ravel() - (columns - 1) / 2, y.ravel() - (rows - 1) / 2], axis=1)
        return places * self.pitch_mm

    def at_rest(self) -> SkinState:
        """Return the skin without contact, at time zero."""
        rest_mm = self.rest_mm()
        marker_mm = np.column_stack((rest_mm, np.zeros(len(rest_mm))))
        return SkinState(0, marker_mm, gradient=np.tile(np.eye(2), (len(rest_mm), 1, 1)))


# Most markers and contacts of a scene: they stay below 100 MB and a minute of planning.
MOST_MARKERS, MOST_CONTACTS = 10_000, 10_000
LOADED = "load_scene('demo')"  # How a scene is made, for errors.


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraChoice:
    """The camera preset, and the settings that differ from it.

    Attributes:
        preset: ``clean``, ``typical`` or ``noisy``, or the path of a camera's TOML file.
        settings: Tables as in a camera file, which override parts of the preset.
    """

    preset: str = "typical"
    settings: dict[str, Any] = field(default_factory=dict)

    def resolve(self) -> CameraConfig:
        """Return the camera with its settings.

        Raises:
            ConfigError: The preset or a setting is unknown or out of range.
        """
        preset = to_mapping(load_camera(self.preset))
        return build(CameraConfig, merged(preset, self.settings), "camera")


@dataclass(frozen=True, kw_only=True, slots=True)
class HistoryConfig:
    """What the sensor has seen before the recording. It is simulated but not recorded.

    The reference of a pixel is the level at its last event, so that no sensor in use has fresh
    references. The history affects the camera only: the gel starts relaxed, and the markers start
    at rest.

    Attributes:
        references: Reference levels before the drag. ``rested``: the leak has moved each reference
            by a random part of a threshold, as after minutes of rest. ``random``: as after
            arbitrary motions. ``fresh``: exact, as no real sensor's are (for tests of the camera).
        wait_s: Time from the end of the drag to the start of the recording, s. The leak continues
            in it.
        slide_mm: Distance by which the whole skin is dragged and released, in a direction drawn
            from the seed, mm; 0 is no drag.
    """

    references: Literal["rested", "random", "fresh"] = "rested"
    wait_s: float = 1.0
    slide_mm: float = 0.3

    def __post_init__(self) -> None:
        require_within(self, wait_s=(0.0, 600.0), slide_mm=(0.0, 100.0))


@dataclass(frozen=True, kw_only=True)
class VariationConfig:
    """Limits of the variation of a contact by the seed.

    Every value is the half-width of a uniform distribution, drawn anew for each contact. If all are
    zero every seed gives the same contact.

    Attributes:
        place_mm: Change of the start's x and of its y, mm.
        heading_deg: Turn of the whole path about its start, degrees.
        yaw_deg: Change of the indenter's own heading, degrees.
        depth_fraction: Relative change of all depths.
        extent_fraction: Relative change of slides, radii of circles and angles of twists.
        speed_fraction: Relative change of all speeds.
        pause_s: Longest additional pause before the contact, s (drawn from 0 upwards).
    """

    place_mm: float = 0.0
    heading_deg: float = 0.0
    yaw_deg: float = 0.0
    depth_fraction: float = 0.0
    extent_fraction: float = 0.0
    speed_fraction: float = 0.0
    pause_s: float = 0.0

    def __post_init__(self) -> None:
        fractions = ("depth_fraction", "extent_fraction", "speed_fraction")
        require_within(self, **dict.fromkeys(fractions, (0.0, 0.9)))
        require_within(self, place_mm=(0.0, 1e3), heading_deg=(0.0, 360.0), yaw_deg=(0.0, 360.0))
        require_within(self, pause_s=(0.0, 1e4))


@dataclass(frozen=True, kw_only=True, slots=True)
class ContactConfig:
    """One body that approaches, touches and leaves, once or several times.

    Attributes:
        indenter: The body.
        motion: Its motion, which starts and ends above the skin.
        repeats: Number of repetitions.
        pause_s: Pause after each repetition, s.
    """

    indenter: IndenterConfig = field(default_factory=IndenterConfig)
    motion: MotionConfig
    repeats: int = 1
    pause_s: float = 0.0

    def __post_init__(self) -> None:
        make_indenter(self.indenter)
        motion = IndenterMotion(self.motion)
        require_within(self, repeats=(1, MOST_CONTACTS), pause_s=(0.0, 1e4))
        if not self.motion.segments or max(motion.pose(at).position_mm[2] for at in
                                           (0.0, motion.duration_s)) >= 0:  # fmt: skip
            raise ValueError(
                "a contact must start above the skin (height_mm > 0) and end above it; "
                "use a lift or a release as its last segment"
            )


@dataclass(frozen=True, kw_only=True, slots=True)
class Scene:
    """The sensor, the contacts, and the variation by the seed.

    Attributes:
        about: Description in one line, for the catalogue.
        lead_in_s: Time without contact before the first contact, s.
        lead_out_s: Time after the end of the last motion, s (the return metrics are measured
            there).
        skin: The markers.
        gel: Mechanics of the gel.
        optics: Lens, sensor size and discs.
        camera: The event camera.
        history: What the sensor has seen before the recording.
        variation: Changes by the seed.
        contacts: The contacts in order.
    """

    about: str = ""
    lead_in_s: float = 0.5
    lead_out_s: float = 1.0
    skin: SkinConfig = field(default_factory=SkinConfig)
    gel: GelConfig = field(default_factory=GelConfig)
    optics: OpticsConfig = field(default_factory=OpticsConfig)
    camera: CameraChoice = field(default_factory=CameraChoice)
    history: HistoryConfig = field(default_factory=HistoryConfig)
    variation: VariationConfig = field(default_factory=VariationConfig)
    contacts: tuple[ContactConfig, ...] = ()

    def __post_init__(self) -> None:
        require_within(self, lead_in_s=(0.0, 1e4), lead_out_s=(0.0, 1e4))
        contacts = sum(contact.repeats for contact in self.contacts)
        if contacts > MOST_CONTACTS:
            raise ValueError(f"the scene has {contacts} contacts, valid are up to {MOST_CONTACTS}")
        markers = self.skin.grid[0] * self.skin.grid[1]
        for index in (*self.optics.discs.broken, *self.optics.discs.missing):
            if not 0 <= index < markers:
                raise ValueError(f"marker {index} does not exist, valid are 0 to {markers - 1}")
        self.camera.resolve()

    @property
    def size(self) -> tuple[int, int]:
        """``(width, height)`` of the sensor, px."""
        return self.optics.size

    def with_camera(self, preset: str | None) -> Scene:
        """Return the scene with another camera preset; the scene's camera settings still apply."""
        return self if preset is None else replace(self, camera=replace(self.camera, preset=preset))

    def with_serial(self, serial: int | None) -> Scene:
        """Return the scene with another individual sensor; None is the same one."""
        return self if serial is None else replace(self, skin=replace(self.skin, serial=serial))

    def resolved(self) -> dict[str, Any]:
        """Return all values of the scene, with those of the camera preset."""
        camera = to_mapping(self.camera.resolve())
        return to_mapping(self) | {"camera": {"preset": self.camera.preset, "settings": camera}}

    def digest(self) -> str:
        """Return the SHA-256 of :meth:`resolved`, as hexadecimal digits."""
        text = json.dumps(self.resolved(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()
