"""Where ``spikingtac probe`` searches: on the twin, or with a UR arm and its Robotiq gripper."""

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import tyro

import spikingtac as st
from spikingtac import contact, events, robot
from spikingtac import sim as twin
from spikingtac.cli.messages import progress, remark
from spikingtac.cli.options import WriteArgs
from spikingtac.pipeline.track import require_same_size
from spikingtac.robot.guard_loop import watched_windows
from spikingtac.stream.reader import EventReader
from spikingtac.stream.real_time import exempt_from_collection
from spikingtac.types import FloatArray

QUIET_WINDOWS = 4000  # Windows of the arm at rest from which the detector learns, 1 ms each.

# When a camera's stream counts as lost. The fastest touch then continues for 0.6 mm, or for 1.5
# mm, which is a force of 0.06 N at 0.04 N/mm.
STALE_S, BACKLOG_S = 0.1, 0.25

# Wait after the gripper has closed, s: the gel has crept most of its way by then.
GRIP_SETTLE_S = 1.0
OPEN, CLOSED = 0, 255  # Positions of the gripper (Robotiq's scale).
# Fraction of the computing time on the twin that the calibration takes, measured.
CALIBRATED_FRACTION = 0.6
CYCLES = 3  # Touches in each direction of that calibration.
CALIBRATION_STREAM, SEARCH_STREAM = 4, 5  # Numbers of the random streams of the readings.

# Assumptions of every search, and of one on the twin.
ASSUMPTIONS = (
    "the hole is round, and deep enough that only its side is met",
    "the bit is a hexagon of 0.75 mm across flats",
)
ASSUMPTIONS_ON_TWIN = (
    *ASSUMPTIONS,
    "gel, optics, camera, arm, bit and hole are simulated",
    "delta_crit and the bit's heading come from touches of a flat wall at a known place",
    "the arm's repeatability, 0.028 mm per axis and reading, was added to every reading",
)
ASSUMPTIONS_ON_ARM = (
    *ASSUMPTIONS,
    "delta_crit is the given one in every direction, its spread holds the arm's repeatability",
    "the bit's heading is unknown; its mean reach, 0.41 mm, was taken",
    "nothing touched during the first 4 s of the stream, from which the detector learnt",
)


@dataclass(frozen=True, kw_only=True)
class Args(WriteArgs):
    """Find centre and radius of one hole by touch; on the twin unless an arm is given.

    The probe must stand in the hole. This is not a safety function: it does not replace the robot's
    protective stop.

    Attributes:
        output: Folder for hole.json and hole.png; nothing is written unless given.
        arm: Address of a UR arm in remote control; the twin is used unless given.
        events: With --arm: the finger's camera, a named pipe; a recording only with --rehearsal.
        rehearsal: With --arm: allow --events to be a recording. The arm then moves by what was felt
            earlier, and feels nothing: no contact stops it.
        calibration: With --arm: calibration.json of that finger.
        gripper: With --arm: close its Robotiq gripper on the probe before the search, and report
            the grip.
        release: With --gripper: open the gripper after the search.
        travel_mm: With --arm: delta_crit, the tip's travel from touch to decision, mm, from a known
            wall.
        travel_sigma_mm: With --arm: standard deviation of this travel from touch to touch, mm.
        radius_mm: On the twin: true radius of the hole, mm.
        seed: On the twin: seed of everything random.
        contacts: Largest number of contacts.
        center_sigma_mm: The search ends at this standard deviation of the centre along
            each axis, mm.
        travel_limit_mm: Largest travel of one approach, mm; a hole must be smaller.
        force_limit_n: Largest force of the tip, N, even if no wall is detected; it limits the
            travel.
        detector: Contact detector: default (signed, sequential) or event_count (as published).
    """

    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")] = None
    arm: str | None = None
    events: Path | None = None
    rehearsal: bool = False
    calibration: Path | None = None
    gripper: bool = False
    release: bool = False
    travel_mm: float = 0.12
    travel_sigma_mm: float = 0.03
    radius_mm: float = 2.0
    seed: int = 0
    contacts: int = 12
    center_sigma_mm: float = 0.0
    travel_limit_mm: float = 11.0
    force_limit_n: float = 0.5
    detector: Annotated[str, tyro.conf.arg(metavar="default|event_count")] = "default"

    def probing(self) -> st.ProbingConfig:
        """Return how the search touches."""
        limits = {"travel_limit_mm": self.travel_limit_mm, "force_limit_n": self.force_limit_n}
        return st.ProbingConfig(conditions=True, **limits)

    def searching(self) -> dict[str, Any]:
        """Return the settings of the adaptive search."""
        return {"contacts": self.contacts, "center_sigma_mm": self.center_sigma_mm}


class ProbedHole(NamedTuple):
    """The estimate of a hole, with the search that led to it.

    Attributes:
        found: The estimate and its contacts.
        travel: The travel by which the readings were corrected.
        assumed: The assumptions, in sentences.
        given: What the search depended on beside its settings.
        true_center_mm: ``(2,)`` the hole's centre, where it is known, mm.
        grip: How the gripper holds the probe; None without a gripper.
    """

    found: st.FoundHole
    travel: st.TravelModel
    assumed: tuple[str, ...]
    given: dict[str, Any]
    true_center_mm: FloatArray | None = None
    grip: dict[str, Any] | None = None


def on_twin(args: Args) -> ProbedHole:
    """Calibrate on a flat wall of the twin, then search one hole.

    Raises:
        SearchError: There is no wall, no room, or no circle; the arm is at rest.
    """
    site = twin.HoleSite(args.seed, args.seed)
    trial = twin.hole_trial(args.radius_mm, np.zeros(2), twin.CORNER_MM, args.seed)
    remark("calibrating on a flat wall, then probing the hole; this takes one or two minutes")
    with progress("calibrate on a flat wall, then probe") as advance:
        quiet, config = twin.quiet_windows(site), st.DetectionConfig()
        detector = st.make_detector(args.detector, config, [site.calibration], quiet)
        plain = twin.prober_for(site, detector, twin.DEFAULT)
        on_walls = twin.RecordingProber(plain, [args.seed, CALIBRATION_STREAM])
        twin.touch_flat_walls(site, on_walls, twin.DEFAULT, CYCLES)
        travel = twin.travel_of(on_walls.stored, twin.PLANNING_MM)
        advance(CALIBRATED_FRACTION)
        remark("calibrated; probing the hole")
        site.set_wall(trial.wall, trial.start_mm)
        arm, windows, free = site.rig.arm, site.rig.windows(), site.free_travel
        prober = robot.ArmProber(arm, windows, detector, args.probing(), free_travel=free)
        in_hole = twin.RecordingProber(prober, [args.seed, SEARCH_STREAM])
        found = st.probe_hole(in_hole, travel, trial.start_mm, **args.searching())
    start_mm = tuple(trial.start_mm.tolist())
    given = {"seed": args.seed, "radius_mm": args.radius_mm, "start_mm": start_mm}
    return ProbedHole(found, travel, ASSUMPTIONS_ON_TWIN, given, trial.center_mm)


def on_arm(args: Args) -> ProbedHole:
    """Search a hole with a UR arm, from where it stands.

    Raises:
        SearchError: There is no wall, no room, or no circle; the arm is at rest.
        DeviceError: Arm, gripper or sensor failed; the arm was commanded to stop.
    """
    assert args.arm is not None
    assert args.calibration is not None
    calibration = st.Calibration.load(args.calibration)  # refused before anything moves
    travel, grip = st.TravelModel.of(args.travel_mm, args.travel_sigma_mm), None
    with contextlib.ExitStack() as stack:
        gripper = stack.enter_context(robot.RobotiqGripper(args.arm)) if args.gripper else None
        if gripper is not None:
            grip = close_on_probe(gripper)
        found = _search_hole(args, calibration, travel, stack)
        if gripper is not None and args.release:
            gripper.move(OPEN)
    given = {"events": str(args.events), "calibration": str(args.calibration)}
    return ProbedHole(found, travel, ASSUMPTIONS_ON_ARM, given, grip=grip)


def _search_hole(
    args: Args, calibration: st.Calibration, travel: st.TravelModel, stack: contextlib.ExitStack
) -> st.FoundHole:
    """Learn from the quiet stream, connect the arm, and search under a watchdog."""
    stream, reader = listen(args, calibration)
    if reader is not None:
        stack.callback(reader.release)
    quiet = list(islice(stream, QUIET_WINDOWS))
    if not any(contact.count_of(window) for window in quiet):  # a working sensor has noise and leak
        raise st.DeviceError(
            f"the sensor gave no event in its first {len(quiet)} windows of 1 ms: it is dead, "
            "covered or masked, or the stream is empty; check the camera, nothing was moved"
        )
    detector = st.make_detector(args.detector, st.DetectionConfig(), [calibration], quiet)
    if reader is not None:
        exempt_from_collection()
    arm, watchdog = robot.URArm(args.arm or ""), None
    stack.callback(arm.close)
    if reader is not None:
        watchdog = robot.Watchdog(
            arm.stop,
            time.monotonic,
            confirm=arm.confirm_stop,
            stale_s=STALE_S,
            backlog_s=BACKLOG_S,
        )
        watchdog.self_test()
        reader.give_up()  # what waits is of the past
        stream = watched_windows(reader, watchdog)
        stack.enter_context(robot.WatchdogThread(watchdog))
    prober = robot.ArmProber(arm, stream, detector, args.probing(), watchdog)
    return st.probe_hole(prober, travel, **args.searching())


def close_on_probe(gripper: robot.RobotiqGripper) -> dict[str, Any]:
    """Close the gripper gently, and return the grip: ``object`` and ``position`` (0 to 255).

    Raises:
        DeviceError: The gripper holds nothing, reports a fault, or does not answer.
    """
    gripper.activate()
    found = gripper.move(CLOSED)
    position = gripper.position()
    if found is not robot.Grip.HELD_CLOSING:
        raise st.DeviceError(
            f"the gripper closed to position {position} of {CLOSED} and holds nothing; "
            "put the probe between its fingers and start again"
        )
    time.sleep(GRIP_SETTLE_S)
    return {"object": "held", "position": position}


def listen(
    args: Args, calibration: st.Calibration
) -> tuple[Iterator[contact.Window], EventReader | None]:
    """Return the windows of the finger, 1 ms each, and of a camera what reads it in a thread.

    Raises:
        CalibrationError: The calibration belongs to a sensor of another size.
    """
    assert args.events is not None
    source = st.open_events(args.events)
    require_same_size(source.size, calibration.size)
    reader = EventReader(source, source) if events.is_stream(args.events) else None
    packets = source if reader is None else (found.packet for found in reader)
    return ((window,) for window in st.windows(packets, period_us=1000)), reader
