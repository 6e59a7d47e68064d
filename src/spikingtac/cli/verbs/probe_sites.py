"""Where ``spikingtac probe`` searches: on the twin, or with a UR arm and its Robotiq gripper."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from itertools import islice
from typing import Any

import numpy as np

import spikingtac as st
from spikingtac import contact, events, robot
from spikingtac import sim as twin
from spikingtac.cli.messages import progress, remark
from spikingtac.cli.sources import ended_by_sigterm
from spikingtac.cli.verbs.probe_args import Args, ProbedHole
from spikingtac.geometry import Compensation
from spikingtac.pipeline.track import require_same_size
from spikingtac.stream.guard_loop import watched_windows
from spikingtac.stream.reader import EventReader
from spikingtac.stream.real_time import exempt_from_collection
from spikingtac.types import FloatArray

QUIET_WINDOWS = 4000  # Windows of the arm at rest from which the detector learns, 1 ms each.

# When a camera's stream counts as lost. The fastest touch then continues for 0.6 mm, or for 1.5
# mm, which is a force of 0.06 N at 0.04 N/mm.
LIVE = robot.WatchdogConfig(stale_s=0.1, backlog_s=0.25)

# Wait after the gripper has closed, s: the gel has crept most of its way by then.
GRIP_SETTLE_S = 1.0
OPEN, CLOSED = 0, 255  # Positions of the gripper (Robotiq's scale).
# Fraction of the computing time on the twin that the calibration takes, measured.
CALIBRATED_FRACTION = 0.6
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


def search(args: Args, prober: Any, travel: st.TravelModel, start_mm: FloatArray) -> st.FoundHole:
    """Search a hole, and return the estimate with its contacts.

    Args:
        args: The arguments of the verb.
        prober: Makes the touches.
        travel: Calibrated travel.
        start_mm: ``(2,)`` start inside the hole, mm.

    Raises:
        SearchError: There is no wall, no room, or no circle; the arm is at rest.
    """
    if args.search == "default":
        return st.probe_hole(prober, travel, start_mm, **args.searching())
    touches = robot.cross_search(prober, start_mm, travel)
    return st.FoundHole(robot.calibrated_circle(touches, travel), tuple(touches))


def on_twin(args: Args) -> ProbedHole:
    """Calibrate on a flat wall of the twin, then search one hole.

    Raises:
        SearchError: There is no wall, no room, or no circle; the arm is at rest.
    """
    site = twin.HoleSite(twin.Grasp.of(args.seed), args.seed)
    trial = twin.hole_trial(args.radius_mm, np.zeros(2), twin.CORNER_MM, args.seed)
    style, cycles = (twin.DEFAULT, 3) if args.search == "default" else (twin.CROSS, 4)
    remark("calibrating on a flat wall, then probing the hole; this takes about half a minute")
    with progress("calibrate on a flat wall, then probe") as advance:
        quiet, config = twin.quiet_windows(site), st.DetectionConfig()
        detector = st.make_detector(args.detector, config, [site.calibration], quiet)
        plain = twin.prober_for(site, detector, style)
        on_walls = twin.RecordingProber(plain, [args.seed, CALIBRATION_STREAM])
        twin.touch_flat_walls(site, on_walls, style, cycles)
        travel = twin.travel_of(on_walls.stored, twin.PLANNING_MM)
        advance(CALIBRATED_FRACTION)
        remark("calibrated; probing the hole")
        site.set_wall(trial.wall, trial.start_mm)
        arm, windows, free = site.rig.arm, site.rig.windows(), site.free_travel
        prober = robot.ArmProber(arm, windows, detector, args.probing(), free_travel=free)
        in_hole = twin.RecordingProber(prober, [args.seed, SEARCH_STREAM])
        found = search(args, in_hole, travel, trial.start_mm)
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
    known = Compensation(travel_mm=args.travel_mm, travel_sigma_mm=args.travel_sigma_mm)
    travel, grip = st.TravelModel.of(known), None
    with ended_by_sigterm(), contextlib.ExitStack() as stack:
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
        watchdog = robot.Watchdog(LIVE, arm.stop, time.monotonic, confirm=arm.confirm_stop)
        watchdog.self_test()
        reader.give_up()  # what waits is of the past
        stream = watched_windows(reader, watchdog)
        stack.enter_context(robot.WatchdogThread(watchdog))
    prober = robot.ArmProber(arm, stream, detector, args.probing(), watchdog)
    return search(args, prober, travel, prober.place_mm())


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
