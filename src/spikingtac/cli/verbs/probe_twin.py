"""``spikingtac probe`` on the twin: calibrate on a flat wall, then search one hole."""

from __future__ import annotations

import numpy as np

from spikingtac.cli.messages import progress, remark
from spikingtac.cli.probe_search import (
    ASSUMPTIONS,
    Args,
    probing_style,
    resolved_config,
    search,
)
from spikingtac.cli.verbs.probe_result import ProbedHole, readings
from spikingtac.contact.detector import ContactDetector
from spikingtac.geometry.travel import TravelModel
from spikingtac.plots.hole import HolePicture
from spikingtac.robot.prober import ArmProber
from spikingtac.sim.rig import hole_site
from spikingtac.sim.rig.hole_site import (
    CORNER_MM,
    CROSS,
    DEFAULT,
    PLANNING_MM,
    Grasp,
    HoleSite,
    RecordingProber,
    hole_trial,
)

# Calibration touches per direction: 16 for the cross, 36 for the adaptive search.
CYCLES = {CROSS: 4, DEFAULT: 3}

# Fraction of the computing time that the calibration takes (ours: measured).
CALIBRATED_FRACTION = 0.6
CALIBRATION_STREAM, SEARCH_STREAM = 4, 5  # Numbers of the random streams of the readings.
ASSUMPTIONS_ON_TWIN = (
    *ASSUMPTIONS,
    "gel, optics, camera, arm, bit and hole are simulated",
    "delta_crit and the bit's heading come from touches of a flat wall at a known place",
    "the arm's repeatability, 0.028 mm per axis and reading, was added to every reading",
)


def on_twin(args: Args) -> ProbedHole:
    """Calibrate on a flat wall of the twin, then search one hole.

    Raises:
        SearchError: There is no wall, no room, or no circle; the arm is at rest.
    """
    site = HoleSite(Grasp.of(args.seed), args.seed)
    trial = hole_trial(args.radius_mm, np.zeros(2), CORNER_MM, args.seed)
    remark("calibrating on a flat wall, then probing the hole; this takes about half a minute")
    with progress("calibrate on a flat wall, then probe") as advance:
        detector, travel = calibrate(args, site)
        advance(CALIBRATED_FRACTION)
        remark("calibrated; probing the hole")
        site.set_wall(trial.wall, trial.start_mm)
        prober = ArmProber(
            site.rig.arm,
            site.windows(),
            detector,
            probing_style(args),
            free_travel=site.free_travel,
        )
        reader = RecordingProber(prober, [args.seed, SEARCH_STREAM])
        circle, touches = search(args, reader, travel, trial.start_mm)
    x, y = trial.start_mm.tolist()
    given = {"seed": args.seed, "radius_mm": args.radius_mm, "start_mm": (x, y)}
    return ProbedHole(
        picture=HolePicture(
            circle=circle,
            reading_mm=readings(touches),
            true_center_mm=trial.center_mm,
            true_radius_mm=args.radius_mm,
        ),
        touches=touches,
        travel=travel,
        method={"search": args.search, "detector": args.detector},
        config=resolved_config(args) | given,
        assumed=ASSUMPTIONS_ON_TWIN,
    )


def calibrate(args: Args, site: HoleSite) -> tuple[ContactDetector, TravelModel]:
    """Return the detector, from quiet windows, and the travel, from touches of a flat wall."""
    style = DEFAULT if args.search == "default" else CROSS
    quiet = hole_site.quiet_windows(site)
    detector = hole_site.detector_for(site, args.detector, quiet)
    plain = hole_site.prober_for(site, detector, style)
    prober = RecordingProber(plain, [args.seed, CALIBRATION_STREAM])
    hole_site.touch_flat_walls(site, prober, style, CYCLES[style])
    return detector, hole_site.travel_of(prober.stored, PLANNING_MM)
