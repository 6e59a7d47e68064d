"""Cases of the point-tracking experiment: which trials make up which row."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from spikingtac.experiments.trials.trials import V2E, Trial
from spikingtac.sim.scene.catalog import TRAJECTORIES

ALL = "all"
"""Row over the ten trajectories."""

CAMERAS: dict[str, tuple[str, float]] = {
    "": ("typical", 0.0),
    "noisy/": ("noisy", 0.0),
    "noisy-loss30/": ("noisy", 0.3),
}
"""Prefix of a case -> preset of the camera, and share of the events that is lost besides."""

DAMAGES = (1, 4, 8)
"""Numbers of damaged markers."""

DAMAGE_SCENES = ("mixed", "finger-slides", "finger-torsion")
"""Trajectories on which markers are damaged; the first is the one of a quick run."""

FIFTY, LOOPS = "fifty-contacts", "loops"


VARIANTS = ("paper-printed", "evetac-strong")
"""Left out of a quick run; a full one asks them under the typical camera and about v2e only."""

QUICK_MOTION_S = 1.5
"""In a quick run a trajectory's motions that begin later than this are left out, s."""


def trajectory_trials(prefix: str, seeds: range) -> list[Trial]:
    """Return the ten trajectories under one camera, each seed on another sensor of the series."""
    camera, loss = CAMERAS[prefix]
    return [
        Trial(
            case=f"{prefix}{scene}",
            scene=scene,
            seed=seed,
            serial=1 + seed,
            camera=camera,
            loss=loss,
            groups=(f"{prefix}{ALL}",),
        )
        for scene in TRAJECTORIES
        for seed in seeds
    ]


def main_trials(seeds: range, quick: bool) -> list[Trial]:
    """Return the trials of the main tables, the long ones first so that no process waits for one.

    Args:
        seeds: Of the trajectories and loops.
        quick: No fifty contacts, damage on one trajectory, and shorter sequences.
    """
    fifty = [] if quick else [_single(FIFTY, FIFTY, seed) for seed in seeds[:2]]
    loops = [_single(f"{prefix}{LOOPS}", LOOPS, seed, prefix) for seed in seeds
             for prefix in (("",) if quick else ("", "noisy/"))]  # fmt: skip
    broken = [
        replace(_single(f"broken-{count}", scene, seed), damaged=count)
        for count in DAMAGES
        for scene in (DAMAGE_SCENES[:1] if quick else DAMAGE_SCENES)
        for seed in seeds
    ]
    rest = [trial for prefix in CAMERAS for trial in trajectory_trials(prefix, seeds)]
    motion_s = QUICK_MOTION_S if quick else None
    # A loop that is cut short is not closed.
    return [*fifty, *loops, *(replace(one, motion_s=motion_s) for one in (*rest, *broken))]


def foreign_trials(data: Path | None) -> list[Trial]:
    """Return the v2e recording, where the folder of foreign recordings is there."""
    if data is None or not (data / V2E / "mix.raw").is_file():
        return []
    return [Trial(case=f"{V2E}/mix", scene="mix", camera=V2E, source=V2E)]


def _single(case: str, scene: str, seed: int, prefix: str = "") -> Trial:
    camera, loss = CAMERAS[prefix]
    return Trial(case=case, scene=scene, seed=seed, serial=1 + seed, camera=camera, loss=loss)
