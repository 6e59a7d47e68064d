"""Fit the law of slip to drawn contacts on the twin: ``python scripts/fit_slip_law.py WORK``.

Draws contacts (``spikingtac.experiments.touch.slides``), watches some with camera and tracker and
more without, keeps their features in the folder WORK, and fits the network of
``spikingtac.touch.slip.stick_law``. Needs torch. What the experiment scores is drawn from other
seeds, with a body that is not drawn here.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from spikingtac.experiments.touch.slides import draw_slide
from spikingtac.experiments.touch.watched_slides import (
    WatchedSlide,
    watch_slide,
    watch_without_camera,
)
from spikingtac.touch.slip.feature_stream import FeatureStream
from spikingtac.touch.slip.features import FEATURES
from spikingtac.touch.slip.stick_law import StickLaw

Field = NDArray[np.float64]

SEED = 20_000
"""First seed of the contacts; the experiment begins at 0."""
HIDDEN = 32
EVERY = 4
"""Frames of which one is learned from: neighbours are alike."""
NOISE = 0.3
"""Noise on the features while learning, in their deviations: the law must not lean on details."""
INCIPIENT, GROSS = 0.8, 0.1
"""Sticking shares below which a contact slips in part, or wholly."""
EPOCHS, BATCH, RATE, DECAY = 10, 1024, 4e-3, 1e-3


def main() -> None:
    """Draw, watch, fit, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path, help="folder for the contacts' features")
    parser.add_argument("--seen", type=int, default=200, help="contacts with camera and tracker")
    parser.add_argument("--unseen", type=int, default=400, help="contacts without")
    parser.add_argument("--draw-only", choices=("seen", "unseen"), help="do not fit")
    parser.add_argument("-o", "--output", type=Path, default=Path("stick_law.json"))
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    counts = {"seen": args.seen, "unseen": args.unseen}
    kinds = [args.draw_only] if args.draw_only else list(counts)
    files = [contact(args.work, kind, k) for kind in kinds for k in range(counts[kind])]
    if args.draw_only:
        return
    features, share = joined(files)
    law = fitted(features, share)
    args.output.write_text(json.dumps(law.to_mapping()) + "\n", encoding="utf-8")


def contact(work: Path, kind: str, number: int) -> Path:
    """Return the file of a contact's features, drawn and watched if it is not there."""
    path = work / f"{kind}_{number:04d}.npz"
    if not path.exists():
        seed = SEED + number + (100_000 if kind == "unseen" else 0)
        slide = draw_slide(np.random.default_rng(seed))
        watched = (watch_slide if kind == "seen" else watch_without_camera)(slide, seed)
        features = features_of(watched)
        np.savez(
            path,
            features=features.astype(np.float32),
            t_us=watched.t_us,
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


def joined(files: list[Path]) -> tuple[Field, Field]:
    """Return features and true shares of every frame from which something can be learned."""
    features, shares = [], []
    for path in files:
        with np.load(path) as kept:
            used = kept["judged"] & kept["touching"] & np.isfinite(kept["features"][:, 0])
            features.append(kept["features"][used])
            shares.append(kept["share"][used])
    return np.concatenate(features)[::EVERY], np.concatenate(shares)[::EVERY]


def fitted(features: Field, share: Field, seed: int = 0) -> StickLaw:
    """Return the law that explains the shares best, by cross entropy."""
    torch.manual_seed(seed)
    middle, deviation = features.mean(axis=0), features.std(axis=0) + 1e-6
    inputs = torch.tensor((features - middle) / deviation, dtype=torch.float32)
    truth = np.stack([share, share < INCIPIENT, share < GROSS], axis=1)
    targets = torch.tensor(truth.astype(np.float32))
    net = torch.nn.Sequential(
        torch.nn.Linear(FEATURES, HIDDEN),
        torch.nn.Tanh(),
        torch.nn.Linear(HIDDEN, HIDDEN),
        torch.nn.Tanh(),
        torch.nn.Linear(HIDDEN, targets.shape[1]),
    )
    optimizer = torch.optim.AdamW(net.parameters(), RATE, weight_decay=DECAY)
    steps = EPOCHS * -(-len(inputs) // BATCH)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=steps)
    for _ in range(EPOCHS):
        for batch in torch.randperm(len(inputs)).split(BATCH):
            seen = inputs[batch]
            told = net(seen + NOISE * torch.randn_like(seen))
            loss = torch.nn.functional.binary_cross_entropy_with_logits(told, targets[batch])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    layers = [layer for layer in net if isinstance(layer, torch.nn.Linear)]
    weights = tuple(layer.weight.detach().double().numpy().round(5) for layer in layers)
    offsets = tuple(layer.bias.detach().double().numpy().round(5) for layer in layers)
    return StickLaw(middle.round(6), deviation.round(6), weights, offsets)


if __name__ == "__main__":
    main()
