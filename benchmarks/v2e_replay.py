"""The twin's camera beside v2e, on the motions of the public v2e recordings, whole.

    python benchmarks/v2e_replay.py [DATA_FOLDER] [--plot docs/explanation/images/v2e-replay.png]

The folder holds ``v2e/{bootstrap,mix,quiet}.raw`` and their ``.truth.npz``; without one,
``SPIKINGTAC_DATA`` or ``../shared/data`` is taken. Background is compared on ``quiet`` and taken
off the counts of the motions. ``no dead time`` shows what the dead time explains.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.stats import wasserstein_distance

from spikingtac.events.open import open_events
from spikingtac.sim.camera.camera import EventCamera
from spikingtac.sim.camera.config import CameraConfig, load_camera
from spikingtac.sim.optics.states import MarkerImage
from spikingtac.types import EventPacket

NEAR_PX = 6.0
SAMPLE = 23
BIN_US = 50_000
Truth = dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Comparison:
    """One motion through both simulators; background taken off the counts and shares."""

    name: str
    ours: EventPacket
    theirs: EventPacket
    ours_motion: float
    theirs_motion: float
    ours_on: float
    theirs_on: float
    ours_px: NDArray[np.float64]
    theirs_px: NDArray[np.float64]

    @property
    def apart_px(self) -> float:
        """Wasserstein distance of the two distributions of distance to the edge."""
        return float(wasserstein_distance(self.ours_px, self.theirs_px))


def load_truth(folder: Path, name: str) -> Truth:
    with np.load(folder / f"{name}.truth.npz") as archive:
        return {key: archive[key].astype(np.float64) for key in archive.files}


def read(folder: Path, name: str) -> EventPacket:
    return EventPacket.concatenate(list(open_events(folder / f"{name}.raw")))


def render(config: CameraConfig, truth: Truth) -> EventPacket:
    camera = EventCamera(config, seed=11)
    shape = np.tile(np.eye(2), (len(truth["radius_px"]), 1, 1))
    shots = [
        MarkerImage(int(t_us), center, shape, truth["radius_px"])
        for t_us, center in zip(truth["marker_t_us"], truth["marker_px"], strict=True)
    ]
    camera.settle(shots[0], "fresh")
    return camera.advance(shots[1:])


def edge_distance_px(packet: EventPacket, truth: Truth) -> NDArray[np.float64]:
    """Return sampled events' signed distances to the nearest edge, those within 6 px."""
    sample = packet.select(slice(None, None, SAMPLE))
    t_us = truth["marker_t_us"]
    nearest = np.full(len(sample), np.inf)
    for marker, radius in enumerate(truth["radius_px"]):
        x, y = (np.interp(sample.t, t_us, truth["marker_px"][:, marker, k]) for k in (0, 1))
        off = np.hypot(sample.x - x, sample.y - y) - radius
        nearest = np.where(np.abs(off) < np.abs(nearest), off, nearest)
    return nearest[np.abs(nearest) < NEAR_PX]


def compare(folder: Path, name: str, config: CameraConfig, noise_hz: float) -> Comparison:
    truth, theirs = load_truth(folder, name), read(folder, name)
    ours = render(config, truth)
    noise = noise_hz * truth["marker_t_us"][-1] * 1e-6
    counts = [len(packet) - noise for packet in (ours, theirs)]
    on = [float(packet.p.sum() - noise / 2) for packet in (ours, theirs)]
    return Comparison(
        name=name,
        ours=ours,
        theirs=theirs,
        ours_motion=counts[0],
        theirs_motion=counts[1],
        ours_on=on[0] / counts[0],
        theirs_on=on[1] / counts[1],
        ours_px=edge_distance_px(ours, truth),
        theirs_px=edge_distance_px(theirs, truth),
    )


def plot(comparisons: list[Comparison], path: Path) -> None:
    figure, axes = plt.subplots(2, len(comparisons), figsize=(9, 4.6), constrained_layout=True)
    for column, one in enumerate(comparisons):
        edges = np.arange(0, one.ours.t_end_us, BIN_US)
        bins = np.linspace(-NEAR_PX, NEAR_PX, 97)
        pairs = ((one.theirs, one.theirs_px, "v2e"), (one.ours, one.ours_px, "twin"))
        for packet, apart, label in pairs:
            style = {"label": label, "linewidth": 1.0}
            rate = np.histogram(packet.t, edges)[0] / BIN_US
            axes[0, column].plot(edges[:-1] * 1e-6, rate, **style)
            share = np.histogram(apart, bins, density=True)[0]
            axes[1, column].plot((bins[1:] + bins[:-1]) / 2, share, **style)
        axes[0, column].set(title=one.name, xlabel="time, s", ylabel="events, million/s")
        axes[1, column].set(xlabel="distance to the marker's edge, px", ylabel="density, 1/px")
        axes[0, column].legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    default = os.environ.get("SPIKINGTAC_DATA", "../shared/data")
    parser.add_argument("data", nargs="?", type=Path, default=Path(default))
    parser.add_argument("--plot", type=Path)
    options = parser.parse_args()
    folder, config = options.data / "v2e", load_camera("v2e")
    quiet = read(folder, "quiet")
    noise_hz = len(quiet) / (load_truth(folder, "quiet")["marker_t_us"][-1] * 1e-6)
    alive = replace(config, pixel=replace(config.pixel, refractory_us=0.0))
    table = Table("motion", "events, twin / v2e", "ON, twin", "ON, v2e", "edge distance apart px")
    comparisons = [compare(folder, name, config, noise_hz) for name in ("bootstrap", "mix")]
    others = [replace(compare(folder, "mix", alive, noise_hz), name="mix, no dead time")]
    for one in comparisons + others:
        ratio = f"{one.ours_motion / one.theirs_motion:.3f}"
        shares = f"{one.ours_on:.4f}", f"{one.theirs_on:.4f}"
        table.add_row(one.name, ratio, *shares, f"{one.apart_px:.3f}")
    still = render(config, load_truth(folder, "quiet"))
    on = f"{still.p.mean():.4f}", f"{quiet.p.mean():.4f}"
    table.add_row("quiet (background)", f"{len(still) / len(quiet):.3f}", *on, "")
    Console().print(table)
    if options.plot:
        plot(comparisons, options.plot)


if __name__ == "__main__":
    main()
