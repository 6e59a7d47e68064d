"""Where ``spikingtac probe`` probes: on the twin, calibrated on the way, or with a UR arm."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.cli.messages import progress
from spikingtac.cli.robot.probe_result import ProbedHole, TrueHole
from spikingtac.errors import CalibrationError, ConfigError, DeviceError
from spikingtac.geometry.hole import Circle, Compensation
from spikingtac.geometry.travel import TravelModel
from spikingtac.robot.adaptive_search import AdaptiveSearch, AdaptiveSearchConfig
from spikingtac.robot.cross_search import calibrated_circle, cross_search
from spikingtac.robot.prober import ArmProber, Prober, ProbingConfig, Touched
from spikingtac.robot.watchdog import Watchdog, WatchdogConfig, WatchdogThread

if TYPE_CHECKING:
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.cli.robot.probe import Args
    from spikingtac.contact.detector import ContactDetector
    from spikingtac.contact.window import Window
    from spikingtac.live.threaded_source import ThreadedSource
    from spikingtac.robot.arm import Arm
    from spikingtac.sim.rig.hole_site import HoleSite, HoleTrial

Vector = NDArray[np.float64]

QUIET_WINDOWS = 4000
"""Windows of the arm at rest that the detector learns from, of 1 ms."""
LIVE = WatchdogConfig(stale_s=0.1, backlog_s=0.25)
"""When a camera's pipe counts as lost: the fastest touch then goes on for 0.6 mm, or for 1.5 mm,
which a probe of 0.04 N/mm turns into 0.06 N."""
LEAST_RADIUS_MM = 0.5
"""Narrowest hole of the twin, mm."""
TWIN_CYCLES = 3
"""Calibration touches per direction of the adaptive search on the twin: 36 in all."""


def check(args: Args) -> None:
    """Refuse what no search can do, before anything moves or is computed.

    Raises:
        ConfigError: Names the flag, what was given and what is valid.
    """
    positive = ("travel_mm", "travel_sigma_mm", "travel_limit_mm", "force_limit_n")
    for name in positive:
        value = getattr(args, name)
        if not (value > 0.0 and math.isfinite(value)):
            raise ConfigError(f"--{name.replace('_', '-')} is {value:g}; it must be above 0")
    if not (args.radius_mm >= LEAST_RADIUS_MM and math.isfinite(args.radius_mm)):
        raise ConfigError(
            f"--radius-mm is {args.radius_mm:g}; the bit reaches 0.433 mm and needs some room: "
            f"at least {LEAST_RADIUS_MM} mm"
        )
    if args.start_mm is not None and not np.isfinite(args.start_mm).all():
        raise ConfigError(f"--start-mm is {args.start_mm}; it must be two finite numbers, mm")
    if args.start_mm is not None and args.arm is not None:
        raise ConfigError(
            "--start-mm is for the twin; an arm begins where it stands: move it there"
        )
    if args.search == "default":
        _search_config(args)


def on_twin(args: Args) -> ProbedHole:
    """Calibrate on a flat wall of the twin, then probe one hole of it.

    Raises:
        SearchError: No wall, no room, or no circle; the arm is at rest.
    """
    from spikingtac.experiments.holes.readings import RecordingProber
    from spikingtac.sim.rig.hole_site import Grasp, HoleSite

    site = HoleSite(Grasp.of(args.seed), args.seed)
    trial = trial_of(args)
    with progress("calibrate on a flat wall, then probe") as advance:
        detector, travel = calibrated(args, site)
        advance(0.6)
        site.set_wall(trial.wall, trial.start_mm)
        prober = ArmProber(
            site.rig.arm, site.windows(), detector, _style(args), free_travel=site.free_travel
        )
        reader = RecordingProber(prober, [args.seed, 5])
        circle, touches = _search(args, reader, travel, trial.start_mm)
    truth = TrueHole(center_mm=trial.center_mm, radius_mm=args.radius_mm)
    x, y = trial.start_mm.tolist()
    return _found(replace(args, start_mm=(x, y)), circle, touches, travel, _ASSUMED_ON_TWIN, truth)


def trial_of(args: Args) -> HoleTrial:
    """Return the twin's hole, and where the probe begins.

    A start whose bit lies beyond the rim is outside the hole: the probe hangs in free air there.
    """
    from spikingtac.experiments.holes.touching import CORNER_MM
    from spikingtac.sim.rig.hole_site import hole_trial
    from spikingtac.sim.rig.walls import NoWall

    trial = hole_trial(args.radius_mm, np.zeros(2), CORNER_MM, args.seed)
    if args.start_mm is None:
        return trial
    trial = replace(trial, start_mm=np.array(args.start_mm, np.float64))
    outside = float(np.linalg.norm(trial.start_mm)) > args.radius_mm + CORNER_MM
    return replace(trial, wall=NoWall()) if outside else trial


def calibrated(args: Args, site: HoleSite) -> tuple[ContactDetector, TravelModel]:
    """Return the detector, from quiet windows, and the travel, from touches of a flat wall."""
    from spikingtac.experiments.holes import touching as touching
    from spikingtac.experiments.holes.readings import PLANNING_MM, RecordingProber

    style = touching.DEFAULT if args.search == "default" else touching.CROSS
    detector = touching.detector_for(site, args.detector, touching.quiet_windows(site))
    flat = RecordingProber(touching.prober_for(site, detector, style), [args.seed, 4])
    cycles = TWIN_CYCLES if style == touching.DEFAULT else touching.CYCLES[style]
    touching.touch_flat_walls(site, flat, style, cycles)
    return detector, touching.travel_of(flat.kept, PLANNING_MM)


def on_arm(args: Args) -> ProbedHole:
    """Probe with a UR arm, from where it stands.

    Raises:
        SearchError: No wall, no room, or no circle; the arm is at rest.
        DeviceError: Arm or sensor failed; the arm was told to stop.
    """
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.contact.registry import DetectionConfig, make_detector

    assert args.calibration is not None
    calibration = Calibration.load(args.calibration)
    arms: list[Arm] = []
    watchdog = Watchdog(LIVE, lambda: _stop(arms), time.monotonic)
    with contextlib.ExitStack() as stack:
        stream = listen(args, calibration)
        pump = _pumped(args, stream, watchdog)
        if pump is not None:
            stack.callback(pump.close)
            stream = iter(pump)
        quiet = heard_at_rest(stream)
        detector = make_detector(args.detector, DetectionConfig(), [calibration], quiet)
        travel = TravelModel.of(
            Compensation(travel_mm=args.travel_mm, travel_sigma_mm=args.travel_sigma_mm)
        )
        arm = connect(args)
        stack.callback(arm.close)
        arms.append(arm)
        if pump is not None:
            watchdog.self_test()
            pump.skip()
            watchdog.arm()
            stack.enter_context(WatchdogThread(watchdog))
        prober = ArmProber(arm, stream, detector, _style(args), watchdog)
        circle, touches = _search(args, prober, travel, prober.place_mm())
    return _found(args, circle, touches, travel, _ASSUMED_ON_ARM, None)


def _stop(arms: Sequence[Arm]) -> None:
    for arm in arms:
        arm.stop()


def _pumped(args: Args, stream: Iterator[Window], watchdog: Watchdog) -> ThreadedSource | None:
    """Return a pump where the windows come from a camera; a file waits until it is read."""
    from spikingtac.events.formats.evt.raw_stream import is_stream
    from spikingtac.live.arrivals import timed
    from spikingtac.live.threaded_source import ThreadedSource

    assert args.events is not None
    if not is_stream(args.events):
        return None
    return ThreadedSource(timed(stream), watchdog)


def connect(args: Args) -> Arm:
    """Return the arm, at rest.

    Raises:
        DeviceError: It does not answer.
        MissingExtraError: The extra ``[robot]`` is not installed.
    """
    from spikingtac.robot.ur import URArm

    assert args.arm is not None
    return URArm(args.arm)


def listen(args: Args, calibration: Calibration) -> Iterator[Window]:
    """Return the windows of the finger that listens, 1 ms each.

    Raises:
        CalibrationError: The calibration is of another sensor.
    """
    from spikingtac.events.open import open_events
    from spikingtac.events.windows import windows

    assert args.events is not None
    source = open_events(args.events)
    if source.size != calibration.size:
        raise CalibrationError(
            f"--calibration is for {calibration.size[0]}x{calibration.size[1]}, the finger of "
            f"--events is {source.size[0]}x{source.size[1]}; calibrate this sensor: "
            "spikingtac calibrate RECORDING -o calibration.json"
        )
    return ((window,) for window in windows(source, period_us=1000))


def heard_at_rest(stream: Iterator[Window]) -> list[Window]:
    """Return the windows that the detector learns from, before the arm moves.

    Raises:
        DeviceError: There is not one event in them: noise and leak alone make a living sensor
            speak.
    """
    from spikingtac.contact.window import count_of

    quiet = list(islice(stream, QUIET_WINDOWS))
    if not any(count_of(window) for window in quiet):
        raise DeviceError(
            f"the sensor gave no event in its first {len(quiet)} windows of 1 ms: it is dead, "
            "covered or masked, or the stream is empty; check the camera, nothing was moved"
        )
    return quiet


def _style(args: Args) -> ProbingConfig:
    style = ProbingConfig() if args.search == "cross4" else ProbingConfig.conditioned()
    return replace(style, travel_limit_mm=args.travel_limit_mm, force_limit_n=args.force_limit_n)


def _search_config(args: Args) -> AdaptiveSearchConfig:
    return AdaptiveSearchConfig(contacts=args.contacts, center_sigma_mm=args.center_sigma_mm)


def _search(
    args: Args, prober: Prober, travel: TravelModel, start_mm: Vector
) -> tuple[Circle, Sequence[Touched]]:
    if args.search == "cross4":
        touches = cross_search(prober, start_mm, travel)
        return calibrated_circle(touches, travel), touches
    found = AdaptiveSearch(prober, travel, _search_config(args)).run(start_mm)
    return found.circle, found.touches


_ASSUMED = (
    "the hole is round, and deep enough that only its side is met",
    "the bit is a hexagon of 0.75 mm across flats",
)
_ASSUMED_ON_TWIN = (
    *_ASSUMED,
    "gel, optics, camera, arm, bit and hole are simulated",
    "delta_crit and the bit's heading come from touches of a flat wall at a known place",
    "the arm's repeatability, 0.028 mm per axis and reading, was added to every reading",
)
_ASSUMED_ON_ARM = (
    *_ASSUMED,
    "delta_crit is the given one in every direction, its spread holds the arm's repeatability",
    "the bit's heading is unknown; its mean reach, 0.41 mm, was taken",
    "nothing touched during the first 4 s of the stream, from which the detector learnt",
)


def _found(
    args: Args,
    circle: Circle,
    touches: Sequence[Touched],
    travel: TravelModel,
    assumed: Sequence[str],
    truth: TrueHole | None,
) -> ProbedHole:
    config: dict[str, Any] = {"probing": _style(args), "detector": args.detector}
    if args.search == "default":
        config["search"] = _search_config(args)
    if truth is not None:
        config |= {"seed": args.seed, "radius_mm": args.radius_mm, "start_mm": args.start_mm}
    else:
        config |= {"events": str(args.events), "calibration": str(args.calibration)}
    return ProbedHole(
        circle=circle,
        touches=touches,
        travel=travel,
        method={"search": args.search, "detector": args.detector},
        config=config,
        assumed=assumed,
        arm=args.arm,
        truth=truth,
    )
