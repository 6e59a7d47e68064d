"""The cases of the point-tracking experiment, and their trials."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from spikingtac.sim import TRAJECTORIES
from spikingtac_paper.trials.trial import V2E, Trial

ALL = "all"  # Case of all ten trajectories together.

# Prefix of a case -> camera preset, and fraction of the events that is lost in addition.
CAMERAS: dict[str, tuple[str, float]] = {
    "": ("typical", 0.0),
    "noisy/": ("noisy", 0.0),
    "noisy-loss30/": ("noisy", 0.3),
}

DAMAGES = (1, 4, 8)  # Numbers of damaged markers.

# Trajectories with damaged markers; a quick run uses the first one.
DAMAGE_SCENES = ("mixed", "finger-slides", "finger-torsion")

FIFTY, LOOPS = "fifty-contacts", "loops"


# Methods that only a full run uses, with the typical camera and v2e.
VARIANTS = ("paper-printed", "evetac-strong")

QUICK_MOTION_S = 1.5  # A quick run leaves out the motions of a trajectory that begin later, s.


def trajectory_trials(prefix: str, seeds: range) -> list[Trial]:
    """Return the ten trajectories with one camera; each seed uses another sensor specimen."""
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
    """Return the trials of the main tables, the longest first, so that no process waits for one.

    Args:
        seeds: Seeds of the trajectories and loops.
        quick: Leave out the fifty contacts, damage one trajectory, and shorten the sequences.
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
    # Loops are never shortened: they would not be closed.
    return [*fifty, *loops, *(replace(one, motion_s=motion_s) for one in (*rest, *broken))]


def v2e_trials(data: Path | None) -> list[Trial]:
    """Return the trial of the v2e recording, if the folder of recordings has it."""
    if data is None or not (data / V2E / "mix.raw").is_file():
        return []
    return [Trial(case=f"{V2E}/mix", scene="mix", camera=V2E, source=V2E)]


def _single(case: str, scene: str, seed: int, prefix: str = "") -> Trial:
    camera, loss = CAMERAS[prefix]
    return Trial(case=case, scene=scene, seed=seed, serial=1 + seed, camera=camera, loss=loss)
