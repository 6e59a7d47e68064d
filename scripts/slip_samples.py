"""Contacts on the twin that the slip model is fitted to, as camera and tracker see them.

They are drawn by ``spikingtac_paper.touch.contacts``. What the experiment scores is drawn from
other seeds, with a body that is not drawn here.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim.gel import GelConfig
from spikingtac.touch.slip.features import FEATURES, FeatureStream
from spikingtac_paper.touch.contacts import CARRY, KINDS, VARIED_KINDS, draw_contact
from spikingtac_paper.touch.slip import WatchedContact, watch_contact

Field = NDArray[np.float64]

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
