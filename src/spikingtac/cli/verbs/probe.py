"""``spikingtac probe``: find centre and radius of one hole by touch, on the twin or a real arm."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.cli.messages import Table, progress, remark, tell
from spikingtac.cli.probe_search import ASSUMPTIONS, Args, ProbedHole, search
from spikingtac.errors import ConfigError
from spikingtac.plots.figure import PICTURE_ENDINGS
from spikingtac.robot.prober import ArmProber

# Fraction of the computing time on the twin that the calibration takes, measured.
CALIBRATED_FRACTION = 0.6
CALIBRATION_STREAM, SEARCH_STREAM = 4, 5  # Numbers of the random streams of the readings.
ASSUMPTIONS_ON_TWIN = (
    *ASSUMPTIONS,
    "gel, optics, camera, arm, bit and hole are simulated",
    "delta_crit and the bit's heading come from touches of a flat wall at a known place",
    "the arm's repeatability, 0.028 mm per axis and reading, was added to every reading",
)


def run(args: Args) -> int:
    """Probe a hole, write the result, and print it."""
    args.check()
    paths = _output_paths(args)
    if args.arm is not None:
        from spikingtac.cli.verbs.probe_arm import on_arm

        found = on_arm(args)
    else:
        found = on_twin(args)
    summary: dict[str, Any] = found.summary() | (found.write(*paths) if paths else {})
    rows = [
        (name, summary[name], summary[f"{name}_sigma"], summary.get(f"{name}_error", "-"))
        for name in ("x_mm", "y_mm", "radius_mm")
    ]
    columns = ("", "estimate", "standard deviation", "error (simulated)")
    place = "simulated" if summary["simulated"] else "real arm"
    table = Table(f"hole from {summary['contacts']} contacts ({place})", columns, rows)
    written = [f"written: {paths[0]}, {paths[1]}"] if paths else []
    return tell(args.json, summary, table, *written)


def _output_paths(args: Args) -> tuple[Path, Path] | None:
    """Return the paths of document and picture, and create their folder.

    Raises:
        ConfigError: The ending is not valid, the folder cannot be created, or a file is there.
    """
    output = args.output
    if output is None:
        return None
    ending = output.suffix.lower()
    if ending == ".json":
        paths = output, output.with_suffix(".png")
    elif ending in PICTURE_ENDINGS:
        paths = output.with_suffix(".json"), output
    elif not ending or output.is_dir():
        paths = output / "hole.json", output / "hole.png"
    else:
        raise ConfigError(
            f"--output is {str(output)!r}; give a folder, or a file that ends in .json, "
            f"{', '.join(PICTURE_ENDINGS)}"
        )
    try:
        paths[0].parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(
            f"cannot write into {str(paths[0].parent)!r}: {error.strerror}; give another folder"
        ) from error
    args.claim(*paths)
    return paths


def on_twin(args: Args) -> ProbedHole:
    """Calibrate on a flat wall of the twin, then search one hole.

    Raises:
        SearchError: There is no wall, no room, or no circle; the arm is at rest.
    """
    from spikingtac.sim.rig import hole_site as twin

    site = twin.HoleSite(twin.Grasp.of(args.seed), args.seed)
    trial = twin.hole_trial(args.radius_mm, np.zeros(2), twin.CORNER_MM, args.seed)
    style, cycles = (twin.DEFAULT, 3) if args.search == "default" else (twin.CROSS, 4)
    remark("calibrating on a flat wall, then probing the hole; this takes about half a minute")
    with progress("calibrate on a flat wall, then probe") as advance:
        detector = twin.detector_for(site, args.detector, twin.quiet_windows(site))
        plain = twin.prober_for(site, detector, style)
        on_walls = twin.RecordingProber(plain, [args.seed, CALIBRATION_STREAM])
        twin.touch_flat_walls(site, on_walls, style, cycles)
        travel = twin.travel_of(on_walls.stored, twin.PLANNING_MM)
        advance(CALIBRATED_FRACTION)
        remark("calibrated; probing the hole")
        site.set_wall(trial.wall, trial.start_mm)
        prober = ArmProber(
            site.rig.arm, site.windows(), detector, args.probing, free_travel=site.free_travel
        )
        in_hole = twin.RecordingProber(prober, [args.seed, SEARCH_STREAM])
        circle, touches = search(args, in_hole, travel, trial.start_mm)
    start_mm = tuple(trial.start_mm.tolist())
    return ProbedHole(
        args=args,
        circle=circle,
        touches=touches,
        travel=travel,
        assumed=ASSUMPTIONS_ON_TWIN,
        given={"seed": args.seed, "radius_mm": args.radius_mm, "start_mm": start_mm},
        true_center_mm=trial.center_mm,
    )
