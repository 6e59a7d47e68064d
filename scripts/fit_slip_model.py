"""Fit the slip model to drawn contacts on the twin: ``python scripts/fit_slip_model.py WORK``.

Draws contacts, watches them through camera and tracker, keeps their features in the folder WORK,
fits four recurrent networks, and writes them as one ONNX file, which ``spikingtac.touch.slip``
runs. Needs torch.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from spikingtac.sim.gel import GelConfig
from spikingtac.touch.slip.features import FEATURES, FeatureStream
from spikingtac_paper.touch.contacts import CARRY, KINDS, VARIED_KINDS, draw_contact
from spikingtac_paper.touch.slip import WatchedContact, watch_contact
from spikingtac_paper.training.small_networks import Schedule, export, fit

Field = NDArray[np.float64]
Weights = dict[str, Any]

# Seed of the first contact and of the first carried body; the experiment's lie below.
FIRST_SEED, FIRST_CARRIED_SEED = 20_000, 320_000
USUAL_GELS = (GelConfig(),)

# The contract's gel, and others, in which half of the contacts are.
GELS = 3 * USUAL_GELS + tuple(GelConfig(thickness_mm=h_mm) for h_mm in (2.0, 2.5, 4.0))


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Contacts that a network is fitted to.

    Attributes:
        contacts: How many.
        carried: How many bodies are carried besides (with 60 instead of 180, 6 of 600 moves
            began with a false alarm, with 180 none did).
        kinds: What the contacts are drawn from.
        gels: Their gels.
    """

    contacts: int
    carried: int
    kinds: tuple[str, ...]
    gels: tuple[GelConfig, ...]


SAMPLES = {
    "usual": Sample(contacts=1_290, carried=180, kinds=KINDS, gels=USUAL_GELS),
    "varied": Sample(contacts=1_900, carried=190, kinds=VARIED_KINDS, gels=GELS),
}


def drawn(work: Path, name: str) -> list[Path]:
    """Return the files of a sample's features; what is not there is drawn and watched."""
    folder, sample = work / name, SAMPLES[name]
    folder.mkdir(parents=True, exist_ok=True)
    contacts = [contact(folder, sample, number) for number in range(sample.contacts)]
    return contacts + [contact(folder, sample, k, carried=True) for k in range(sample.carried)]


def contact(folder: Path, sample: Sample, number: int, *, carried: bool = False) -> Path:
    """Return the file of a contact's features, drawn and watched if it is not there."""
    path = folder / f"{'carried' if carried else 'contact'}_{number:04d}.npz"
    if not path.exists():
        seed = (FIRST_CARRIED_SEED if carried else FIRST_SEED) + number
        kinds = (CARRY,) if carried else sample.kinds
        slide = draw_contact(np.random.default_rng(seed), kinds=kinds, gels=sample.gels)
        watched = watch_contact(slide, seed)
        np.savez(
            path,
            features=features_of(watched).astype(np.float32),
            share=watched.share,
            judged=np.isfinite(watched.share) if carried else watched.judged,
            touching=watched.touching,
            about=f"{slide.scene.about}, {slide.friction:.2f}, {slide.speed_mm_s:.1f} mm/s",
        )
        print(path, flush=True)
    return path


def features_of(watched: WatchedContact) -> Field:
    """Return the features ``(n, FEATURES)`` of every frame; nan where there are none."""
    stream = FeatureStream(watched.reference_px)
    out = np.full((len(watched.t_us), FEATURES), np.nan)
    for row, (t_us, moved) in enumerate(zip(watched.t_us.tolist(), watched.moved_px, strict=True)):
        features = stream.update(t_us, moved)
        if features is not None:
            out[row] = features
    return out


OUTPUTS = 2  # The sticking share, and the probability of incipient slip.

# Steps after which the hidden state of an untouched skin no longer changes.
SETTLING_STEPS = 500
HIDDEN = ENCODING = 40  # Sizes of hidden state and encoding (32 learns more slowly).
FRAME_US = 1_000

# Frames between two of its steps (4 tells fewer slips ahead, 2 costs more and is alike).
STEP_FRAMES = 3

# Noise on the features while learning, in their deviations: as much again stays for the whole
# contact. The model must not lean on details.
NOISE = 0.3 / np.sqrt(2.0)

# Sticking share, incipient and gross slip; the last only steadies the learning: alarms on the
# share itself err less.
TARGETS = 3
RATE, DECAY = 4e-3, 1e-2
BATCH = 24  # Contacts at a time.
WHOLLY = 0.2  # Sticking share below which all of a contact slips.

# A contact slips in part, too, where all of it does so many frames later. Between slipping and
# holding for long lies what is not judged.
ANNOUNCED_FRAMES = 80

# Frames after which a slip is no news, and what the further ones weigh.
LATE_FRAMES, LATE_WEIGHT = 100, 0.3

# Long contacts are learned in pieces, each from so many frames before it on: an unrolled network
# takes one step after the other, so short courses side by side are faster (a second of
# run-up is taken to be all that the memory needs).
PIECE_FRAMES, RUN_UP_FRAMES = 4_000, 1_000


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """How one of the networks is fitted.

    Attributes:
        sample: Name of what it is fitted to.
        epochs: Turns through that (with a third of the steps alarms are half as good).
        partly: Sticking share below which a contact slips in part.
        announced_frames: It slips wholly, too, where all of it does so many frames later.
        steadiness: How much more it costs to ring an alarm of a contact that holds, per target.
        seed: Of its first weights, and of the order of the contacts.
    """

    sample: str
    epochs: int
    partly: float
    announced_frames: int
    steadiness: tuple[float, float, float]
    seed: int


RECIPES = tuple(
    Recipe(sample=sample, epochs=epochs, partly=partly, announced_frames=frames,
           steadiness=steadiness, seed=seed)
    for sample, epochs in (("usual", 80), ("varied", 60))
    for seed, (partly, frames, steadiness) in enumerate(
        [(0.75, 15, (0.0, 2.0, 0.5)), (0.8, 30, (0.0, 3.0, 1.0))]
    )
)  # fmt: skip

# A contact holds where more than this share sticks from so many frames before to so many after:
# no incipient slip may be told of it.
HOLDS, HOLDS_FRAMES = 0.85, (20, 300)
GRIPS, GRIPS_FRAMES = 0.3, (20, 100)  # The same of gross slip.
SLIPS = 0.05  # Sticking share below which all of it slips.


def main() -> None:
    """Draw, watch, fit, write."""
    parser = argparse.ArgumentParser(description="Fit the slip model.")
    parser.add_argument("work", type=Path, help="folder for the contacts' features")
    parser.add_argument("-o", "--output", type=Path, default=Path("slip.onnx"))
    args = parser.parse_args()
    networks = []
    for recipe in RECIPES:
        whole = [Course.read(path, recipe) for path in drawn(args.work, recipe.sample)]
        courses = [piece for course in whole for piece in course.pieces()]
        networks.append(fitted(courses, recipe))
    args.output.write_bytes(SlipNetworks(networks).exported(STEP_FRAMES * FRAME_US))


@dataclass(frozen=True)
class Course:
    """One contact or a piece of it.

    Attributes:
        features: ``(n, FEATURES)``; nan where there are none.
        there: ``(n,)`` whether something touches.
        targets: ``(n, TARGETS)``.
        known: ``(n, TARGETS)`` what each weighs; zero where it is not known.
    """

    features: NDArray[np.float32]
    there: NDArray[np.bool_]
    targets: NDArray[np.float32]
    known: NDArray[np.float32]

    @classmethod
    def read(cls, path: Path, recipe: Recipe) -> Course:
        """Read a file of :func:`contact`."""
        with np.load(path) as kept:
            features = kept["features"]
            there = kept["touching"] & np.isfinite(features[:, 0])
            judged, share = kept["judged"] & there, kept["share"]
        stuck = np.where(np.isfinite(share), share, 1.0)
        partly = (stuck < recipe.partly) | (_least(stuck, 0, ANNOUNCED_FRAMES) < SLIPS)
        wholly = (stuck < WHOLLY) | (_least(stuck, 0, recipe.announced_frames) < SLIPS)
        told = np.tile(np.isfinite(share)[:, None], TARGETS)
        told[:, 1] = partly | (_least(stuck, *HOLDS_FRAMES) > HOLDS)
        told[:, 2] = wholly | (_least(stuck, *GRIPS_FRAMES) > GRIPS)
        late = _run(judged & (stuck < SLIPS)) > LATE_FRAMES
        weight = judged * np.where(late, LATE_WEIGHT, 1.0)
        targets = np.column_stack([stuck, partly, wholly]).astype(np.float32)
        return cls(features, there, targets, (told * weight[:, None]).astype(np.float32))

    def pieces(self) -> Iterator[Course]:
        """Yield the course in pieces, or itself where it is short."""
        if len(self.features) <= 2 * PIECE_FRAMES:
            yield self
            return
        for begin in range(0, len(self.features), PIECE_FRAMES):
            first = max(begin - RUN_UP_FRAMES, 0)
            rows = slice(first, begin + PIECE_FRAMES)
            known = self.known[rows].copy()
            known[: begin - first] = 0.0
            yield Course(self.features[rows], self.there[rows], self.targets[rows], known)


def _run(flags: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return how many flags in a row there are up to each."""
    count = np.arange(1, len(flags) + 1)
    return count - np.maximum.accumulate(np.where(flags, 0, count))


def _least(stuck: Field, before: int, after: int) -> Field:
    """Return the least share from so many frames before each to so many after."""
    padded = np.concatenate([np.full(before, stuck[0]), stuck, np.full(after, stuck[-1])])
    return np.lib.stride_tricks.sliding_window_view(padded, before + after + 1).min(axis=1)


class Net(torch.nn.Module):
    """One network while it learns, with a further output."""

    def __init__(self) -> None:
        """Draw the weights."""
        super().__init__()
        self.encoder = torch.nn.Linear(FEATURES, ENCODING)
        self.gru = torch.nn.GRU(ENCODING, HIDDEN, batch_first=True)
        self.head = torch.nn.Linear(HIDDEN + ENCODING, TARGETS)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Return the logits ``(b, n, TARGETS)`` of features ``(b, n, FEATURES)``."""
        encoding = torch.tanh(self.encoder(features))
        return self.head(torch.cat([self.gru(encoding)[0], encoding], -1))


class SlipNetworks(torch.nn.Module):
    """What runs: one step of all networks side by side, and the mean of what they tell."""

    def __init__(self, networks: list[Weights]) -> None:
        """Stack the weights: of each network ``mean``, ``std`` and its layers."""
        super().__init__()
        self.mean = np.array([one["mean"] for one in networks])
        for name in ("encoder", "input_gates", "hidden_gates", "head"):
            weights = np.array([one[name][0] for one in networks])
            bias = np.array([one[name][1] for one in networks])
            if name == "encoder":
                weights = weights / np.array([one["std"] for one in networks])[:, None]
                bias = bias - (weights @ self.mean[..., None])[..., 0]
            for part, values in (("weights", weights.swapaxes(1, 2)), ("bias", bias[:, None])):
                self.register_buffer(f"{name}_{part}", torch.tensor(values, dtype=torch.float32))

    def _layer(self, name: str, values: torch.Tensor) -> torch.Tensor:
        weights, bias = getattr(self, f"{name}_weights"), getattr(self, f"{name}_bias")
        return torch.matmul(values, weights) + bias

    def forward(self, features: torch.Tensor, hidden: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return the mean outputs and the hidden states ``(k, 1, h)`` after a step."""
        encoding = torch.tanh(self._layer("encoder", features))
        given = self._layer("input_gates", encoding).chunk(3, dim=2)
        kept = self._layer("hidden_gates", hidden).chunk(3, dim=2)
        reset = torch.sigmoid(given[0] + kept[0])
        update = torch.sigmoid(given[1] + kept[1])
        new = torch.tanh(given[2] + reset * kept[2])
        hidden = new + update * (hidden - new)
        told = torch.sigmoid(self._layer("head", torch.cat([hidden, encoding], dim=2)))
        return told.mean(dim=0)[0], hidden

    def exported(self, step_us: int) -> bytes:
        """Return the networks as an ONNX file that knows the hidden state at rest."""
        hidden = torch.zeros(len(self.mean), 1, HIDDEN)
        rest = torch.tensor(self.mean[:, None], dtype=torch.float32)
        with torch.no_grad():
            for _ in range(SETTLING_STEPS):
                hidden = self(rest, hidden)[1]
        record = {
            "schema": 5, "step_us": step_us, "initial": hidden.tolist(),
            "fitted": "contacts drawn on the twin", "trainer": "scripts/fit_slip_model.py",
        }  # fmt: skip
        inputs = {"features": torch.zeros(1, FEATURES), "hidden": hidden}
        return export(self, inputs, ("estimate", "hidden_after"), record, free_axes={})


def fitted(courses: list[Course], recipe: Recipe) -> Weights:
    """Return the network that tells the courses best, by cross entropy."""
    torch.manual_seed(recipe.seed)
    rng = np.random.default_rng(recipe.seed)
    known = np.concatenate([c.features[c.known.any(axis=1)][::8] for c in courses])
    scale = known.mean(axis=0), known.std(axis=0) + 1e-6
    net, lengths = Net(), [len(course.features) for course in courses]
    fit(
        net,
        lambda: _batches(lengths, BATCH, rng),
        lambda network, rows: _loss(
            network, *_batch([courses[row] for row in rows], scale, rng), recipe.steadiness
        ),
        Schedule(rate=RATE, decay=DECAY, epochs=recipe.epochs, largest_gradient=1.0),
    )
    return _weights(net, scale)


def _batches(lengths: list[int], size: int, rng: np.random.Generator) -> list[list[int]]:
    """Return the rows of each batch: courses of about the same length."""
    order = np.argsort(np.array(lengths) + rng.normal(0.0, 200.0, len(lengths)))
    batches = [order[k : k + size].tolist() for k in range(0, len(order), size)]
    rng.shuffle(batches)
    return batches


def _batch(
    courses: list[Course], scale: tuple[Field, Field], rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return features, targets and what is known of these, each from a random frame on."""
    shape = len(courses), -(-max(len(course.features) for course in courses) // STEP_FRAMES)
    features = np.zeros((*shape, FEATURES), np.float32)
    targets, known = np.zeros((2, *shape, TARGETS), np.float32)
    for row, course in enumerate(courses):
        every = slice(int(rng.integers(STEP_FRAMES)), None, STEP_FRAMES)
        scaled = np.nan_to_num((course.features[every] - scale[0]) / scale[1])
        count = len(scaled)
        features[row, :count] = scaled * course.there[every, None]
        targets[row, :count], known[row, :count] = course.targets[every], course.known[every]
    return torch.tensor(features), torch.tensor(targets), torch.tensor(known)


def _loss(
    net: torch.nn.Module,
    features: torch.Tensor,
    targets: torch.Tensor,
    known: torch.Tensor,
    steadiness: tuple[float, ...],
) -> torch.Tensor:
    fresh, lasting = torch.randn(features.shape), torch.randn(len(features), 1, FEATURES)
    told = net(features + NOISE * (fresh + lasting))
    loss = torch.nn.functional.binary_cross_entropy_with_logits(told, targets, reduction="none")
    weights = known * (1.0 + torch.tensor(steadiness) * (1.0 - targets))
    return (loss * weights).sum() / weights.sum()


def _weights(net: Net, scale: tuple[Field, Field]) -> Weights:
    kept = {name: values.double().numpy() for name, values in net.state_dict().items()}
    return {
        "mean": scale[0],
        "std": scale[1],
        "encoder": (kept["encoder.weight"], kept["encoder.bias"]),
        "input_gates": (kept["gru.weight_ih_l0"], kept["gru.bias_ih_l0"]),
        "hidden_gates": (kept["gru.weight_hh_l0"], kept["gru.bias_hh_l0"]),
        "head": (kept["head.weight"][:OUTPUTS], kept["head.bias"][:OUTPUTS]),
    }


if __name__ == "__main__":
    main()
