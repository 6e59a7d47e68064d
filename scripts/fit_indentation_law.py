"""Fit the law of indentation on the twin: ``python scripts/fit_indentation_law.py WORK``.

Draws contacts of many sizes, depths and places on the twin's gel, keeps their skins in the folder
WORK, shows them to cameras at many distances, adds the errors of tracks and growths, and fits the
network of ``spikingtac.touch.indentation.indentation_law``. Needs torch.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from drawn_skins import SKIN, CameraView, Draw, drawn
from fitted_mlp import Schedule, fitted_mlp
from numpy.typing import NDArray
from weights_file import write_weights

from spikingtac.touch.indentation.field_features import FEATURES, FieldFeatures
from spikingtac.touch.indentation.indentation_law import (
    DEPTH_SCALE,
    LOG_SIGMA,
    OUTPUTS,
    SIGMA_SCALE,
    IndentationLaw,
)
from spikingtac_paper.touch.bodies import BOTH_RADII, Body

Field = NDArray[np.float64]

BODIES = (
    Body("ball", "ball", {BOTH_RADII: (0.8, 9.0)}, (0.1, 1.3)),
    Body("punch", "punch", {("radius_mm",): (0.6, 4.5)}, (0.08, 0.6)),
    Body("finger", "finger", {BOTH_RADII: (5.0, 8.5)}, (0.4, 2.6)),
)
"""What is drawn: smaller, larger, lighter and deeper than for the slip model."""
DRAW = Draw(first_seed=500_000, bodies=BODIES)
CONTACTS = 2000
LEAST_DEPTH_MM = 0.03
"""Skins that are indented by less are rest, of which one in a contact is kept, mm."""
KEPT_SHARE = 3
"""Of the others one in so many is kept."""
DISTANCE_MM = (9.0, 18.0)
"""Range of the cameras' distances from the skin, mm: about the twin's 13."""
PLACE_SIGMA_PX = (0.03, 0.12)
"""Range of the tracks' errors, px per axis, of frame after frame."""
GROWTH_SIGMA = (0.003, 0.009)
"""Range of the errors of a disc's growth, as a share of its radius (ours)."""
COMMON_SIGMA = 0.003
"""Error of the growth that all discs of a frame share."""
HIDDEN = (96, 48)
SCHEDULE = Schedule(batch=12, rate=4e-3, decay=1e-3, epochs=20)
TOUCHED, TOUCHED_WEIGHT = 0.05, 10.0
"""Pitches of indentation above which a marker counts more, and by how much."""
SQUARED_WEIGHT = 0.05
"""Of the plain squared error beside the likelihood: a network that begins with large deviations
learns nothing else."""
ERROR_FACTOR = 2.0
"""By which deviations are multiplied: with it 95 % of the true values of the training scenes, seen
with camera and tracker, lie within two (their hard bodies twist and circle; q95 is 4.1 without)."""


@dataclass(frozen=True, slots=True)
class View:
    """The frames of a contact as a camera shows them.

    Attributes:
        features: Of its markers.
        moved_px: ``(n, m, 2)`` displacements, px.
        growth: ``(n, m)`` growths of the discs' radii, 0.1 is 10 %.
        nearness: Pitch of the markers over the camera's distance.
        depth: ``(n, m)`` indentations, in pitches.
    """

    features: FieldFeatures
    moved_px: Field
    growth: Field
    nearness: float
    depth: Field


def main() -> None:
    """Draw, show, fit, write."""
    parser = argparse.ArgumentParser(description="Fit the law of indentation.")
    parser.add_argument("work", type=Path, help="folder for the skins")
    parser.add_argument("--contacts", type=int, default=CONTACTS)
    parser.add_argument("--epochs", type=int, default=SCHEDULE.epochs)
    parser.add_argument("--without-growth", action="store_true", help="to see what it is worth")
    parser.add_argument("--error-factor", type=float, default=ERROR_FACTOR)
    parser.add_argument("-o", "--output", type=Path, default=Path("indentation_law.json"))
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    paths = [drawn(args.work, number, DRAW) for number in range(args.contacts)]
    views = [view(path, rng, args.without_growth) for path in paths]
    law = fitted(views, rng, args.epochs, args.without_growth)
    law = replace(law, error_factor=args.error_factor)
    write_weights(args.output, law.to_mapping())


def view(path: Path, rng: np.random.Generator, without_growth: bool) -> View:
    """Return a contact as a camera at some distance sees it, turned or mirrored."""
    with np.load(path) as archive:
        place, gradient = archive["mm"].astype(float), archive["grad"].astype(float)
    deepest = place[..., 2].max(axis=1)
    kept = np.append(np.flatnonzero(deepest > LEAST_DEPTH_MM)[::KEPT_SHARE], 0)
    camera = CameraView.drawn(rng, DISTANCE_MM)
    moved, growth = camera.seen(place[kept], gradient[kept])
    return View(
        FieldFeatures(camera.reference_px, np.zeros(2)),
        moved,
        growth * (not without_growth),
        SKIN.pitch_mm / camera.distance_mm,
        place[kept][:, camera.order, 2] / SKIN.pitch_mm,
    )


def noisy(one: View, rng: np.random.Generator, without_growth: bool) -> NDArray[np.float32]:
    """Return features ``(k, FEATURES)`` of a view with fresh errors of tracks and growths."""
    frames = len(one.growth)
    place = rng.normal(size=one.moved_px.shape) * rng.uniform(*PLACE_SIGMA_PX, (frames, 1, 1))
    growth = rng.normal(size=one.growth.shape) * rng.uniform(*GROWTH_SIGMA, (frames, 1))
    growth += rng.normal(0.0, COMMON_SIGMA, (frames, 1))
    grown = (one.growth + growth) * (not without_growth)
    features = one.features.of(one.moved_px + place, grown, one.nearness)
    return features.reshape(-1, FEATURES).astype(np.float32)


def fitted(
    views: list[View], rng: np.random.Generator, epochs: int, without_growth: bool
) -> IndentationLaw:
    """Return the law that fits the views."""

    def loss(network: torch.nn.Sequential, chosen: list[View]) -> torch.Tensor:
        seen = np.concatenate([noisy(one, rng, without_growth) for one in chosen])
        depth = np.concatenate([one.depth.ravel() for one in chosen]).astype(np.float32)
        return loss_of(network(torch.from_numpy(seen)), torch.from_numpy(depth))

    schedule = replace(SCHEDULE, epochs=epochs)
    sizes = (FEATURES, *HIDDEN, OUTPUTS)
    return IndentationLaw(fitted_mlp(sizes, views, loss, schedule, rng, lambda _, mean: mean))


def loss_of(told: torch.Tensor, depth: torch.Tensor) -> torch.Tensor:
    """Return the weighted negative log likelihood of the depths, in pitches."""
    log_sigma = torch.clamp(told[:, 1], *LOG_SIGMA)
    error = (told[:, 0] * DEPTH_SCALE - depth) / SIGMA_SCALE
    weight = 1.0 + TOUCHED_WEIGHT * (depth > TOUCHED)
    likelihood = 0.5 * (error * torch.exp(-log_sigma)) ** 2 + log_sigma
    return (weight * (likelihood + SQUARED_WEIGHT * error**2)).mean()


if __name__ == "__main__":
    main()
