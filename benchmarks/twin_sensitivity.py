"""What the twin's results depend on: spectrum, contrast, thresholds, noise, history of the pixels.

    python benchmarks/twin_sensitivity.py [--seed 0]

Prints Markdown tables for docs/explanation/twin.md. Everything in them is simulated, on one seed
and on short scenes: they show directions and sizes, and are no acceptance figures.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from spikingtac.sim.gel.creep import SpectrumConfig
from spikingtac.sim.scene import catalog
from spikingtac.sim.scene.scene import Scene
from spikingtac.sim.scene.source import SceneSource
from spikingtac.sim.scene.truth import TruthChunk
from spikingtac.types import EventPacket

SPECTRA = {
    "elastic (none)": ((), ()),
    "conditioned: .03 .03 .03 at .02 .3 5 s": ((0.03, 0.03, 0.03), (0.02, 0.3, 5.0)),
    "**pinned: .05 .05 .12 at .02 .3 8 s**": ((0.05, 0.05, 0.12), (0.02, 0.3, 8.0)),
    "doubled: .10 .10 .24 at .02 .3 8 s": ((0.1, 0.1, 0.24), (0.02, 0.3, 8.0)),
}
"""Name -> (retarded shares of the compliance, times in s)."""

SLIDE_S = 1.6
"""Beginning of ``bootstrap`` that holds its first slide, out and back."""


def spectra(seed: int) -> Iterable[tuple[object, ...]]:
    """Yield the true residual at the end of three trajectories for each spectrum."""
    for name, (shares, times_s) in SPECTRA.items():
        cells: list[object] = [name]
        for trajectory in ("finger-torsion", "drag-release", "comb-slides"):
            scene = catalog.load(trajectory)
            spectrum = SpectrumConfig(fractions=shares, times_s=times_s)
            scene = replace(scene, gel=replace(scene.gel, spectrum=spectrum))
            source = SceneSource(scene, seed)
            *_, (_, last) = source.frames()
            away = np.linalg.norm(last.center_px - source.reference_px, axis=1)
            cells.append(f"{away.mean():.3f} ({away.max():.3f})")
        yield tuple(cells)


def cameras(seed: int) -> Iterable[tuple[object, ...]]:
    """Yield events per px of motion for contrasts, thresholds and bandwidths."""
    settings: dict[str, dict[str, Any]] = {
        f"contrast {contrast:g}": {"light": {"contrast": contrast}}
        for contrast in (3.0, 4.0, 6.0, 8.0, 12.5)
    }
    for threshold in (0.18, 0.25, 0.35):
        pixel = {"threshold_on": threshold, "threshold_off": threshold}
        settings[f"thresholds {threshold:g}"] = {"pixel": pixel}
    settings["bandwidth 500 Hz"] = {"pixel": {"bandwidth_hz": 500.0}}
    settings["refractory 200 us"] = {"pixel": {"refractory_us": 200.0}}
    settings["mismatch 0.06"] = {"pixel": {"mismatch": 0.06}}
    for name, changed in settings.items():
        scene = _filmed(catalog.load("bootstrap"), "clean", changed)
        light = scene.camera.resolve(scene.size)
        steps = np.log(light.light.contrast) / light.pixel.threshold_on
        packet, truth, radius_px = _run(scene, seed, SLIDE_S)
        path_px = np.linalg.norm(np.diff(truth.marker_px, axis=0), axis=2).sum()
        per_px = len(packet) / path_px
        diameter = 2 * float(radius_px.mean())
        low, high = 2 * diameter * (steps - 1), 2 * diameter * (steps - 0.5)
        yield name, f"{per_px:.0f}", f"{low:.0f} to {high:.0f}", f"{packet.p.mean():.3f}"


def presets(seed: int) -> Iterable[tuple[object, ...]]:
    """Yield rates at rest and in motion for each preset."""
    for preset in ("clean", "typical", "noisy"):
        quiet, _, _ = _run(catalog.load("quiet").with_camera(preset), seed, 2.0)
        moving, truth, _ = _run(catalog.load("bootstrap").with_camera(preset), seed, SLIDE_S)
        path_px = np.linalg.norm(np.diff(truth.marker_px, axis=0), axis=2).sum()
        signal = len(moving) - len(quiet) / 2.0 * SLIDE_S
        yield (
            preset,
            f"{len(quiet) / 2e3:.1f}",
            f"{signal / path_px:.0f}",
            _first_touch(preset, seed),
        )


def _first_touch(preset: str, seed: int) -> str:
    """Return the marker motion at the 100th event beyond the background, by history."""
    found = []
    for references, slide_mm in (("fresh", 0.0), ("rested", 0.0), ("rested", 0.3)):
        scene = catalog.load("finger-slides").with_camera(preset)
        history = replace(scene.history, references=references, slide_mm=slide_mm)
        background = {"background": {"rate_hz": 0.0, "hot_fraction": 0.0}}
        scene = replace(_filmed(scene, preset, background), history=history)
        packet, truth, _ = _run(scene, seed, 1.2)
        touched_us = int(truth.contact_t_us[truth.in_contact.argmax()])
        after = packet.t[packet.t >= touched_us]
        row = int(np.searchsorted(truth.marker_t_us, after[99]))
        moved = np.linalg.norm(truth.marker_px[row] - truth.marker_px[0], axis=1)
        found.append(f"{moved.max():.3f}")
    return " / ".join(found)


def _filmed(scene: Scene, preset: str, settings: dict[str, Any]) -> Scene:
    return replace(scene, camera=replace(scene.camera, preset=preset, settings=settings))


def _run(
    scene: Scene, seed: int, duration_s: float
) -> tuple[EventPacket, TruthChunk, np.ndarray[Any, Any]]:
    source = SceneSource(scene, seed, duration_s)
    steps = list(source.steps())
    packet = EventPacket.concatenate([step.packet for step in steps])
    return packet, TruthChunk.concatenate(step.truth for step in steps), source.radius_px


TABLES = {
    "Residual of the gel at the end of a trajectory, mean (largest) over markers, px": (
        ("spectrum", "finger-torsion", "drag-release", "comb-slides"),
        spectra,
    ),
    "Events per px of motion and marker (clean camera, otherwise pinned)": (
        ("changed", "events/px", "law: 2 d (steps - 1) to 2 d (steps - 1/2)", "ON share"),
        cameras,
    ),
    "The presets": (
        (
            "preset",
            "events/ms at rest",
            "events/px of motion",
            "largest marker motion at the 100th event, px: fresh / rested / released references",
        ),
        presets,
    ),
}


def main() -> None:
    """Print every table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    seed = parser.parse_args().seed
    for title, (columns, rows) in TABLES.items():
        sys.stdout.write(f"\n{title}:\n\n| {' | '.join(columns)} |\n|{' --- |' * len(columns)}\n")
        for row in rows(seed):
            sys.stdout.write(f"| {' | '.join(map(str, row))} |\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
