"""Fit the law of slip to drawn contacts on the twin: ``python scripts/fit_slip_law.py WORK``.

Draws contacts (``spikingtac.experiments.touch.slides``), watches some with camera and tracker and
more without, keeps their features in the folder WORK, and fits the two recurrent networks of
``spikingtac.touch.slip.stick_law``. Needs torch. What the experiment scores is drawn from other
seeds, with a body that is not drawn here.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from spikingtac.experiments.touch.slides import CARRY, KINDS, draw_slide
from spikingtac.experiments.touch.watched_slides import (
    WatchedSlide,
    watch_slide,
    watch_without_camera,
    with_slack,
)
from spikingtac.touch.slip.feature_stream import FeatureStream
from spikingtac.touch.slip.features import FEATURES
from spikingtac.touch.slip.stick_law import OUTPUTS, StickLaw
from spikingtac.touch.slip.stick_network import Layer, StickNetwork

Field = NDArray[np.float64]

FIRST_SEEDS = {"seen": 20_000, "unseen": 120_000, "slack": 120_000, "carried": 300_000}
"""First seed of the contacts of each sort; the experiment's lie below. ``slack`` are those of
``unseen`` again, with what an event camera does not see of a motion that turns back."""
COUNTS = {"seen": 125, "unseen": 1500, "slack": 993, "carried": 40}
WEIGHTS = {"seen": 2}
"""How often a sort is taken; once unless it stands here."""
SLACK_PX = (0.05, 0.3)
MEMORY = SEEN = 32
"""Sizes of the network (ours: half of it errs more, twice is not better)."""
FRAME_US = 1_000
NOISE = 0.3 / np.sqrt(2.0)
"""Noise on the features while learning, in their deviations: as much again stays for the whole
contact. The law must not lean on details."""
TARGETS = 3
"""Sticking share, incipient and gross slip; the last only steadies the learning: alarms on the
share itself err less."""
RATE, DECAY = 4e-3, 1e-2


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """How one of the networks is taught.

    Attributes:
        sorts: Which contacts it sees.
        step_frames: Frames between two of its steps.
        partly: Sticking share below which a contact slips in part.
        wholly: The same of all of it.
        announced_frames: It slips in part and wholly, too, where all of it does so many frames
            later; and between slipping and holding for long lies what is not judged. None: neither.
        steadiness: How much more it costs to ring an alarm of a contact that holds, per target.
        epochs: Turns through all contacts.
        batch: Contacts at a time.
    """

    sorts: tuple[str, ...]
    step_frames: int
    partly: float
    wholly: float
    announced_frames: int | None
    steadiness: tuple[float, float, float]
    epochs: int
    batch: int


RECIPES = (
    Recipe(
        sorts=("seen", "unseen", "slack", "carried"), step_frames=4, partly=0.75, wholly=0.2,
        announced_frames=40, steadiness=(0.0, 2.0, 0.5), epochs=20, batch=64,
    ),
    Recipe(
        sorts=("seen", "unseen"), step_frames=3, partly=0.8, wholly=0.2,
        announced_frames=None, steadiness=(0.0, 1.0, 1.0), epochs=36, batch=32,
    ),
)  # fmt: skip
HOLDS, HOLDS_FRAMES = 0.85, (20, 300)
"""A contact holds where more than this share sticks from so many frames before to so many after: no
incipient slip may be told of it."""
GRIPS, GRIPS_FRAMES = 0.3, (20, 100)
"""The same of gross slip."""
SLIPS = 0.05
"""Sticking share below which all of it slips."""


def main() -> None:
    """Draw, watch, fit, write."""
    parser = argparse.ArgumentParser(description="Fit the law of slip.")
    parser.add_argument("work", type=Path, help="folder for the contacts' features")
    for sort, count in COUNTS.items():
        parser.add_argument(f"--{sort}", type=int, default=count, help=f"contacts {sort}")
    parser.add_argument("--draw-only", choices=tuple(COUNTS), help="do not fit")
    parser.add_argument("-o", "--output", type=Path, default=Path("stick_law.json"))
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    sorts = [args.draw_only] if args.draw_only else list(COUNTS)
    files = {s: [contact(args.work, s, k) for k in range(getattr(args, s))] for s in sorts}
    if args.draw_only:
        return
    networks = []
    for recipe in RECIPES:
        weights = {sort: WEIGHTS.get(sort, 1) for sort in recipe.sorts}
        courses = [
            Course(p, recipe) for s, n in weights.items() for p in files[s] for _ in range(n)
        ]
        networks.append(fitted(courses, recipe))
    law = StickLaw(tuple(networks))
    args.output.write_text(json.dumps(law.to_mapping()) + "\n", encoding="utf-8")


def contact(work: Path, sort: str, number: int) -> Path:
    """Return the file of a contact's features, drawn and watched if it is not there."""
    path = work / f"{sort}_{number:04d}.npz"
    if not path.exists():
        seed = FIRST_SEEDS[sort] + number
        kinds = (CARRY,) if sort == "carried" else KINDS
        slide = draw_slide(np.random.default_rng(seed), kinds=kinds)
        watched = (watch_slide if sort == "seen" else watch_without_camera)(slide, seed)
        if sort == "slack":
            rng = np.random.default_rng([seed, 1])
            watched = with_slack(watched, float(rng.uniform(*SLACK_PX)))
        np.savez(
            path,
            features=features_of(watched).astype(np.float32),
            share=watched.share,
            judged=watched.judged,
            touching=watched.touching,
            about=f"{slide.scene.about}, {slide.friction:.2f}, {slide.speed_mm_s:.1f} mm/s",
        )
        print(path.name, flush=True)
    return path


def features_of(watched: WatchedSlide) -> Field:
    """Return the features ``(n, FEATURES)`` of every frame; nan where there are none."""
    stream = FeatureStream(watched.reference_px)
    out = np.full((len(watched.t_us), FEATURES), np.nan)
    for row, (t_us, moved) in enumerate(zip(watched.t_us.tolist(), watched.moved_px, strict=True)):
        features = stream.update(t_us, moved)
        if features is not None:
            out[row] = features
    return out


class Course:
    """One contact: features, targets and which of these are known."""

    def __init__(self, path: Path, recipe: Recipe) -> None:
        """Read a file of :func:`contact`."""
        with np.load(path) as kept:
            self.features = kept["features"]
            self.there = kept["touching"] & np.isfinite(self.features[:, 0])
            judged, share = kept["judged"] & self.there, kept["share"]
        stuck = np.where(np.isfinite(share), share, 1.0)
        partly, wholly = stuck < recipe.partly, stuck < recipe.wholly
        told = np.tile(np.isfinite(share)[:, None], TARGETS)
        if recipe.announced_frames is not None:
            soon = _least(stuck, 0, recipe.announced_frames) < SLIPS
            partly, wholly = partly | soon, wholly | soon
            told[:, 1] = partly | (_least(stuck, *HOLDS_FRAMES) > HOLDS)
            told[:, 2] = wholly | (_least(stuck, *GRIPS_FRAMES) > GRIPS)
        self.targets = np.column_stack([stuck, partly, wholly]).astype(np.float32)
        self.known = (told & judged[:, None]).astype(np.float32)


def _least(stuck: Field, before: int, after: int) -> Field:
    """Return the least share from so many frames before each to so many after."""
    padded = np.concatenate([np.full(before, stuck[0]), stuck, np.full(after, stuck[-1])])
    return np.lib.stride_tricks.sliding_window_view(padded, before + after + 1).min(axis=1)


class Net(torch.nn.Module):
    """The network of :class:`StickNetwork`, with a further output."""

    def __init__(self) -> None:
        """Draw the weights."""
        super().__init__()
        self.seen = torch.nn.Linear(FEATURES, SEEN)
        self.unit = torch.nn.GRU(SEEN, MEMORY, batch_first=True)
        self.told = torch.nn.Linear(MEMORY + SEEN, TARGETS)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Return the logits ``(b, n, TARGETS)`` of features ``(b, n, FEATURES)``."""
        seen = torch.tanh(self.seen(features))
        return self.told(torch.cat([self.unit(seen)[0], seen], -1))


def fitted(courses: list[Course], recipe: Recipe, seed: int = 0) -> StickNetwork:
    """Return the network that tells the courses best, by cross entropy."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    known = np.concatenate([c.features[c.known.any(axis=1)][::8] for c in courses])
    scale = known.mean(axis=0), known.std(axis=0) + 1e-6
    net, batches = Net(), -(-len(courses) // recipe.batch)
    optimizer = torch.optim.AdamW(net.parameters(), RATE, weight_decay=DECAY)
    steps = recipe.epochs * batches
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=steps)
    for _ in range(recipe.epochs):
        for rows in _batches([len(c.features) for c in courses], recipe.batch, rng):
            parts = _batch([courses[row] for row in rows], scale, recipe.step_frames, rng)
            loss = _loss(net, *parts, torch.tensor(recipe.steadiness))
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
            optimizer.step()
            schedule.step()
    return _network(net, scale, recipe.step_frames * FRAME_US)


def _batches(lengths: list[int], size: int, rng: np.random.Generator) -> list[list[int]]:
    """Return the rows of each batch: courses of about the same length."""
    order = np.argsort(np.array(lengths) + rng.normal(0.0, 200.0, len(lengths)))
    batches = [order[k : k + size].tolist() for k in range(0, len(order), size)]
    rng.shuffle(batches)
    return batches


def _batch(
    courses: list[Course], scale: tuple[Field, Field], step: int, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return features, targets and what is known of these, each from a random frame on."""
    shape = len(courses), -(-max(len(course.features) for course in courses) // step)
    features = np.zeros((*shape, FEATURES), np.float32)
    targets, known = np.zeros((2, *shape, TARGETS), np.float32)
    for row, course in enumerate(courses):
        every = slice(int(rng.integers(step)), None, step)
        scaled = np.nan_to_num((course.features[every] - scale[0]) / scale[1])
        count = len(scaled)
        features[row, :count] = scaled * course.there[every, None]
        targets[row, :count], known[row, :count] = course.targets[every], course.known[every]
    return torch.tensor(features), torch.tensor(targets), torch.tensor(known)


def _loss(
    net: Net,
    features: torch.Tensor,
    targets: torch.Tensor,
    known: torch.Tensor,
    steadiness: torch.Tensor,
) -> torch.Tensor:
    fresh, lasting = torch.randn(features.shape), torch.randn(len(features), 1, FEATURES)
    told = net(features + NOISE * (fresh + lasting))
    loss = torch.nn.functional.binary_cross_entropy_with_logits(told, targets, reduction="none")
    weights = known * (1.0 + steadiness * (1.0 - targets))
    return (loss * weights).sum() / weights.sum()


def _network(net: Net, scale: tuple[Field, Field], step_us: int) -> StickNetwork:
    kept = net.state_dict()

    def layer(weights: str, offsets: str, rows: int | None = None) -> Layer:
        return Layer(*(kept[name].double().numpy()[:rows].round(4) for name in (weights, offsets)))

    return StickNetwork(
        step_us=step_us,
        middle=scale[0].astype(np.float64).round(5),
        deviation=scale[1].astype(np.float64).round(5),
        seen=layer("seen.weight", "seen.bias"),
        fresh=layer("unit.weight_ih_l0", "unit.bias_ih_l0"),
        kept=layer("unit.weight_hh_l0", "unit.bias_hh_l0"),
        told=layer("told.weight", "told.bias", OUTPUTS),
    )


if __name__ == "__main__":
    main()
