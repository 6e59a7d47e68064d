"""The cases of the point-tracking experiment, and their trials."""

from typing import Any

from spikingtac.sim import TRAJECTORIES
from spikingtac_paper.trials.trial import V2E, RecordedTrial, Trial

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


def main_trials(seeds: range, quick: bool) -> list[Trial]:
    """Return the trials of the main tables, the longest first, so that no process waits for one.

    Each seed uses another sensor specimen.

    Args:
        seeds: Seeds of the trajectories and loops.
        quick: Leave out the fifty contacts, damage one trajectory, and shorten the sequences.
    """
    motion_s = QUICK_MOTION_S if quick else None

    def trial(scene: str, seed: int, prefix: str = "", **more: Any) -> Trial:
        camera, loss = CAMERAS[prefix]
        about = {"case": f"{prefix}{scene}", "scene": scene, "seed": seed, "serial": 1 + seed}
        return Trial(**about | {"camera": camera, "loss": loss} | more)

    # Loops are never shortened: they would not be closed.
    return [
        *(trial(FIFTY, seed) for seed in (() if quick else seeds[:2])),
        *(trial(LOOPS, seed, prefix)
          for seed in seeds for prefix in (("",) if quick else ("", "noisy/"))),
        *(trial(scene, seed, prefix, groups=(f"{prefix}{ALL}",), motion_s=motion_s)
          for prefix in CAMERAS for scene in TRAJECTORIES for seed in seeds),
        *(trial(scene, seed, case=f"broken-{count}", damaged=count, motion_s=motion_s)
          for count in DAMAGES
          for scene in (DAMAGE_SCENES[:1] if quick else DAMAGE_SCENES) for seed in seeds),
    ]  # fmt: skip


# The sequence that was rendered by v2e.
V2E_TRIAL = RecordedTrial(
    case=f"{V2E}/mix",
    events=f"{V2E}/mix.raw",
    slides_from=f"{V2E}/bootstrap.raw",
    reference=f"{V2E}/mix.truth.npz",
    source=V2E,
)
