"""Skins under drawn contacts, and how cameras see them: what laws of touch are fitted to.

Contacts are drawn by ``spikingtac_paper.touch.contacts`` and stepped without a camera. No
contact scene is drawn from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim.gel import GelConfig
from spikingtac.sim.optics import Optics, OpticsConfig, SkinState, image_radius_px
from spikingtac.sim.scene import Scene, SkinConfig
from spikingtac.sim.source import SceneSource
from spikingtac_paper.touch.contacts import KINDS, Body, draw_contact

Field = NDArray[np.float64]

PLACE_MM = 6.0  # Contacts begin within this distance of the middle, per axis, mm.

# Steps of the gel, Hz (scenes take 250 to 500; a field without events does with fewer).
MECHANICS_HZ = 100.0
EVERY = 4  # Steps of the gel of which one is kept.

# Range of Brown's first radial coefficient, in units of the tangent of the view angle: from a
# little more than the twin's barrel (-0.05) to none.
DISTORTION = (-0.06, 0.0)
SYMMETRIES = 8  # Ways to turn and mirror a square.
SKIN = SkinConfig()


@dataclass(frozen=True, slots=True)
class Draw:
    """What is drawn from.

    Attributes:
        first_seed: Seed of the first contact.
        bodies: Bodies.
        gels: Their gels.
    """

    first_seed: int
    bodies: Sequence[Body]
    gels: Sequence[GelConfig] = (GelConfig(),)


def drawn(work: Path, number: int, draw: Draw) -> Path:
    """Return the file of a contact's skins, drawn if it is not there."""
    path = work / f"skin_{number:05d}.npz"
    if not path.exists():
        rng = np.random.default_rng(draw.first_seed + number)
        slide = draw_contact(rng, bodies=draw.bodies, kinds=KINDS, gels=draw.gels)
        scene = moved_scene(slide.scene, rng)
        frames = [state for state, _ in SceneSource(scene, number).frames()][::EVERY]
        np.savez(
            path,
            mm=np.array([state.marker_mm for state in frames], np.float32),
            grad=np.array([state.gradient for state in frames], np.float32),
            touching=np.array([state.touching_cells for state in frames]),
        )
    return path


def moved_scene(scene: Scene, rng: np.random.Generator) -> Scene:
    """Return a scene whose contact begins anywhere on the skin."""
    x_mm, y_mm = rng.uniform(-PLACE_MM, PLACE_MM, 2).tolist()
    contact = scene.contacts[0]
    motion = replace(contact.motion, x_mm=x_mm, y_mm=y_mm)
    return replace(scene, mechanics_hz=MECHANICS_HZ, contacts=(replace(contact, motion=motion),))


@dataclass(frozen=True, slots=True)
class CameraView:
    """A skin before one camera, which sees it turned or mirrored.

    Attributes:
        optics: The camera.
        distance_mm: Its distance.
        symmetry: Which of the eight.
        order: ``(m,)`` the marker that comes to each place of the grid.
        reference_px: ``(m, 2)`` markers at rest, px, from the optical axis.
    """

    optics: Optics
    distance_mm: float
    symmetry: int
    order: NDArray[np.int64]
    reference_px: Field

    @classmethod
    def drawn(cls, rng: np.random.Generator, distance_mm: tuple[float, float]) -> CameraView:
        """Return a camera at a distance within the range, mm."""
        config = OpticsConfig(distance_mm=rng.uniform(*distance_mm), k1=rng.uniform(*DISTORTION))
        optics = Optics(config, seed=int(rng.integers(1_000_000)))
        symmetry = int(rng.integers(SYMMETRIES))
        order = turned_order(symmetry, SKIN.grid[0])
        axis_px = (np.array(config.size) - 1.0) / 2.0
        places = turned(optics.project(SKIN.at_rest()).center_px - axis_px, symmetry)
        return cls(optics, config.distance_mm, symmetry, order, places[order])

    def seen(self, places_mm: Field, gradients: Field) -> tuple[Field, Field]:
        """Return displacements ``(n, m, 2)``, px, and growths of the discs ``(n, m)``.

        Args:
            places_mm: ``(n, m, 3)`` of the markers.
            gradients: ``(n, m, 2, 2)`` of the skin there.
        """
        rest = SKIN.at_rest()
        flat = self.optics.project(rest)
        moved, growth = [], []
        for place, gradient in zip(places_mm, gradients, strict=True):
            image = self.optics.project(shaped(rest, place, gradient))
            away = turned(image.center_px - flat.center_px, self.symmetry)
            moved.append(away[self.order])
            growth.append((image_radius_px(image) / image_radius_px(flat) - 1.0)[self.order])
        return np.array(moved), np.array(growth)


def shaped(rest: SkinState, place_mm: Field, gradient: Field) -> SkinState:
    """Return a skin of given places ``(m, 3)`` and gradients ``(m, 2, 2)``."""
    return replace(rest, marker_mm=place_mm, gradient=gradient)


def turned_order(symmetry: int, side: int) -> NDArray[np.int64]:
    """Return which marker comes to each place of a square grid that is turned and mirrored."""
    places = np.rot90(np.arange(side * side).reshape(side, side), symmetry % 4)
    return (places[:, ::-1] if symmetry >= 4 else places).ravel()


def turned(vectors: Field, symmetry: int) -> Field:
    """Return vectors ``(..., 2)`` turned and mirrored likewise."""
    for _ in range(symmetry % 4):
        vectors = np.stack([vectors[..., 1], -vectors[..., 0]], axis=-1)
    return vectors * np.array([-1.0, 1.0]) if symmetry >= 4 else vectors
