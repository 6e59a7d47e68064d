"""Fit the model of the contact patch on the twin: ``python scripts/fit_patch_model.py WORK``.

Draws contacts of many bodies on gels of many thicknesses, keeps their skins in the folder WORK
(half a gigabyte), shows them to cameras at many distances, adds the errors of tracks, and fits the
network that ``spikingtac.touch.patch`` runs to the cells of the skin that are touched.
Needs torch, an hour and a half.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from spikingtac.sim.gel import GelConfig
from spikingtac.sim.optics import Optics, OpticsConfig, image_radius_px
from spikingtac.sim.scene import Scene, SkinConfig
from spikingtac.sim.source import SceneSource
from spikingtac.touch.patch import FEATURES, SIDE, PatchFeatures
from spikingtac_paper.touch.contacts import BOTH_RADII, KINDS, Body, draw_contact
from spikingtac_paper.training.small_networks import Schedule, export, fit

Field = NDArray[np.float64]
Flags = NDArray[np.bool_]

PLACE_MM = 6.0  # Contacts begin within this distance of the middle, per axis, mm.

# Steps of the gel, Hz (scenes take 250 to 500; a field without events does with fewer).
MECHANICS_HZ = 100.0
EVERY = 4  # Steps of the gel of which one is kept.

# Range of Brown's first radial coefficient, in units of the tangent of the view angle: from a
# little more than the twin's barrel (-0.05) to none.
DISTORTION = (-0.06, 0.0)
SYMMETRIES = 8  # Ways to turn and mirror a square.
SKIN = SkinConfig()


def drawn(work: Path, number: int) -> Path:
    """Return the file of a contact's skins, drawn if it is not there."""
    path = work / f"skin_{number:05d}.npz"
    if not path.exists():
        rng = np.random.default_rng(FIRST_SEED + number)
        slide = draw_contact(rng, bodies=BODIES, kinds=KINDS, gels=GELS)
        scene = moved_scene(slide.scene, rng)
        source = SceneSource(scene, number, mechanics_hz=MECHANICS_HZ)
        frames = [state for state, _ in source.frames()][::EVERY]
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
    return replace(scene, contacts=(replace(contact, motion=motion),))


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
            image = self.optics.project(replace(rest, marker_mm=place, gradient=gradient))
            away = turned(image.center_px - flat.center_px, self.symmetry)
            moved.append(away[self.order])
            growth.append((image_radius_px(image) / image_radius_px(flat) - 1.0)[self.order])
        return np.array(moved), np.array(growth)


def turned_order(symmetry: int, side: int) -> NDArray[np.int64]:
    """Return which marker comes to each place of a square grid that is turned and mirrored."""
    places = np.rot90(np.arange(side * side).reshape(side, side), symmetry % 4)
    return (places[:, ::-1] if symmetry >= 4 else places).ravel()


def turned(vectors: Field, symmetry: int) -> Field:
    """Return vectors ``(..., 2)`` turned and mirrored likewise."""
    for _ in range(symmetry % 4):
        vectors = np.stack([vectors[..., 1], -vectors[..., 0]], axis=-1)
    return vectors * np.array([-1.0, 1.0]) if symmetry >= 4 else vectors


_CAPS_MM = {
    ("radius_x_mm",): (2.0, 20.0),
    ("radius_y_mm",): (2.0, 20.0),
    ("half_height_mm",): (4.0, 12.0),
}

# What is drawn: hard and soft, round, flat and long bodies, small and large.
BODIES = (
    Body("small ball", "ball", {BOTH_RADII: (1.0, 10.0)}, (0.1, 1.3)),
    Body("ball", "ball", {BOTH_RADII: (3.0, 10.0)}, (0.1, 1.0)),
    Body("small punch", "punch", {("radius_mm",): (0.8, 5.0)}, (0.08, 0.6)),
    Body("punch", "punch", {("radius_mm",): (1.0, 5.0)}, (0.08, 0.5)),
    Body("finger", "finger", {BOTH_RADII: (5.0, 9.0)}, (0.4, 2.6)),
    Body("ellipsoid", "ball", _CAPS_MM, (0.15, 1.0), turned=True),
    Body(
        "rod",
        "probe",
        {("radius_mm",): (1.0, 6.0), ("length_mm",): (1.0, 10.0)},
        (0.15, 0.9),
        turned=True,
    ),
)
GELS = 3 * (GelConfig(),) + tuple(GelConfig(thickness_mm=h) for h in (2.0, 2.5, 3.5, 4.0, 5.0))
FIRST_SEED = 700_000  # Seed of the first contact.
CONTACTS, VALIDATION = 12_000, 300

# Cameras to which each contact is shown (with one, the network learns it by heart).
VIEWS = 3
FRAMES = 12  # Frames of a contact that a camera sees, at most.
LEAST_DEPTH_MM = 0.03  # Skins that are indented by less are left out, mm.
DISTANCE_MM = (9.0, 30.0)  # Range of the cameras' distances from the skin, mm.
PLACE_SIGMA_PX = (0.03, 0.12)  # Range of the tracks' errors, px per axis, of frame after frame.
HIDDEN = (192, 96)
BATCH = 16
SCHEDULE = Schedule(rate=3e-3, decay=1e-3, largest_gradient=1.0, epochs=14)

# Share of the markers far from the contact that is looked at, each with the weight of many.
COLD_SHARE = 0.15
JUDGED_MM = 3.0  # Diameter from which a patch is judged, mm, by its area.


@dataclass(frozen=True, slots=True)
class View:
    """The frames of a contact as a camera shows them.

    Attributes:
        features: Of its markers.
        moved_px: ``(n, m, 2)`` displacements, px.
        touched: ``(n, m, SIDE * SIDE)`` cells of the skin that are touched.
        hot: ``(n, m)`` markers about which, or beside which, any is.
    """

    features: PatchFeatures
    moved_px: Field
    touched: Flags
    hot: Flags


def main() -> None:
    """Draw, show, fit, write."""
    parser = argparse.ArgumentParser(description="Fit the model of the contact patch.")
    parser.add_argument("work", type=Path, help="folder for the skins")
    parser.add_argument("-o", "--output", type=Path, default=Path("patch.onnx"))
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    paths = [drawn(args.work, number) for number in range(CONTACTS)]
    held, taught = shown(paths[:VALIDATION], rng, 1), shown(paths[VALIDATION:], rng, VIEWS)
    network = fitted(taught, held, rng)
    record = {
        "schema": 2, "side": SIDE, "fitted": f"{len(taught)} views of contacts on the twin",
        "trainer": "scripts/fit_patch_model.py",
    }  # fmt: skip
    told = torch.nn.Sequential(network, torch.nn.Sigmoid())
    inputs = {"features": torch.zeros(1, FEATURES)}
    args.output.write_bytes(export(told, inputs, ("probability",), record))


def shown(paths: list[Path], rng: np.random.Generator, cameras: int) -> list[View]:
    """Return the contacts as so many cameras each see them."""
    views = [view(path, rng) for path in paths for _ in range(cameras)]
    return [one for one in views if one is not None]


def view(path: Path, rng: np.random.Generator) -> View | None:
    """Return a contact as a camera at some distance sees it; None where it hardly touches."""
    with np.load(path) as archive:
        place, gradient = archive["mm"].astype(float), archive["grad"].astype(float)
        bits = archive["touching"]
    rows = np.flatnonzero(bits.any(axis=1) & (place[..., 2].max(axis=1) > LEAST_DEPTH_MM))
    if not len(rows):
        return None
    if len(rows) > FRAMES:
        rows = np.sort(rng.choice(rows, FRAMES, replace=False))
    camera = CameraView.drawn(rng, DISTANCE_MM)
    moved, _ = camera.seen(place[rows], gradient[rows])
    touched = cells_of(bits[rows])[:, camera.order][..., turned_cells(camera.symmetry)]
    features = PatchFeatures(camera.reference_px, np.zeros(2))
    return View(features, moved.astype(np.float32), touched, beside(touched.any(axis=2)))


def offsets() -> Field:
    """Return the centres of a marker's cells from it, in pitches, ``(SIDE * SIDE, 2)``."""
    steps = (np.arange(SIDE) - 0.5 * (SIDE - 1)) / SIDE
    return np.array(list(product(steps, repeat=2)))[:, ::-1]


def cells_of(bits: NDArray[np.uint8]) -> Flags:
    """Return which cells about each marker are touched, from those of the twin's grid."""
    grid = GelConfig().grid
    masks = np.unpackbits(bits, axis=1)[:, : grid.cells**2].astype(bool)
    places = SKIN.rest_mm()[:, None] + offsets() * SKIN.pitch_mm
    column, row = np.moveaxis(np.round(places / grid.pitch_mm + 0.5 * (grid.cells - 1)), -1, 0)
    column, row = (np.clip(k, 0, grid.cells - 1).astype(np.int64) for k in (column, row))
    return masks[:, row * grid.cells + column]


def turned_cells(symmetry: int) -> NDArray[np.int64]:
    """Return which cell comes to each place where the image is turned."""
    away = np.abs(turned(offsets(), symmetry)[None] - offsets()[:, None]).sum(axis=2)
    return away.argmin(axis=1)


def beside(flags: Flags) -> Flags:
    """Return the markers ``(n, m)`` that are flagged or stand beside one that is."""
    side = SKIN.grid[0]
    padded = np.pad(flags.reshape(-1, side, side), ((0, 0), (1, 1), (1, 1)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(1, 2))
    return windows.any(axis=(3, 4)).reshape(flags.shape)


def fitted(views: list[View], held: list[View], rng: np.random.Generator) -> torch.nn.Sequential:
    """Return the network that fits the views."""
    torch.manual_seed(0)
    layers = [torch.nn.Linear(a, b) for a, b in pairwise((FEATURES, *HIDDEN, SIDE * SIDE))]
    bent = [part for layer in layers[:-1] for part in (layer, torch.nn.Tanh())]
    network = torch.nn.Sequential(*bent, layers[-1])

    def batches() -> list[list[View]]:
        order = rng.permutation(len(views))
        return [
            [views[k] for k in order[first : first + BATCH]]
            for first in range(0, len(views) - BATCH + 1, BATCH)
        ]

    fit(
        network,
        batches,
        lambda told, chosen: loss_of(told, [seen(one, rng) for one in chosen]),
        SCHEDULE,
        lambda epoch, _: print(epoch, agreement(network, held).round(3), flush=True),
    )
    return network


def noisy(one: View, rng: np.random.Generator) -> Field:
    """Return the features of a view with fresh errors of tracks."""
    sigma_px = rng.uniform(*PLACE_SIGMA_PX, (len(one.moved_px), 1, 1))
    return one.features.of(one.moved_px + sigma_px * rng.normal(size=one.moved_px.shape))


def seen(one: View, rng: np.random.Generator) -> tuple[Field, Flags, Field]:
    """Return features, touched cells and weights of the markers that are looked at."""
    cold = ~one.hot & (rng.random(one.hot.shape) < COLD_SHARE)
    chosen = one.hot | cold
    return noisy(one, rng)[chosen], one.touched[chosen], np.where(cold[chosen], 1 / COLD_SHARE, 1.0)


def loss_of(network: torch.nn.Module, chosen: list[tuple[Field, Flags, Field]]) -> torch.Tensor:
    """Return the mean cross entropy of the cells."""
    features, touched, weights = (
        torch.from_numpy(np.concatenate(part).astype(np.float32))
        for part in zip(*chosen, strict=True)
    )
    loss = torch.nn.functional.binary_cross_entropy_with_logits(
        network(features), touched, weights[:, None], reduction="sum"
    )
    return loss / (weights.sum() * SIDE**2)


def agreement(network: torch.nn.Sequential, views: list[View]) -> Field:
    """Return mean intersection over union, its tenth percentile, and the share of 0.7 and more."""
    rng, found = np.random.default_rng(1), []
    for one in views:
        with torch.no_grad():
            told = network(torch.tensor(noisy(one, rng), dtype=torch.float32)).numpy() > 0.0
        cells = one.touched.sum(axis=(1, 2))
        judged = cells * (SKIN.pitch_mm / SIDE) ** 2 >= np.pi / 4.0 * JUDGED_MM**2
        both, either = told & one.touched, told | one.touched
        found.append(both.sum(axis=(1, 2))[judged] / either.sum(axis=(1, 2))[judged])
    overlap = np.concatenate(found)
    return np.array([overlap.mean(), np.quantile(overlap, 0.1), (overlap >= 0.7).mean()])


if __name__ == "__main__":
    main()
