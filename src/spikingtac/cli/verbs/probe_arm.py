"""``spikingtac probe`` with a UR arm, and on request its Robotiq gripper."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.cli.probe_search import ASSUMPTIONS, Args, ProbedHole, search
from spikingtac.cli.sources import ended_by_sigterm
from spikingtac.contact.detector import Window, count_of
from spikingtac.contact.registry import DetectionConfig, make_detector
from spikingtac.errors import DeviceError
from spikingtac.events.address import is_stream
from spikingtac.events.open import open_events
from spikingtac.events.windows import windows
from spikingtac.geometry.hole import Circle
from spikingtac.geometry.travel import Compensation, TravelModel
from spikingtac.pipeline.track import require_same_size
from spikingtac.robot.arm import Arm
from spikingtac.robot.prober import ArmProber, Touched
from spikingtac.robot.robotiq import FULL_SCALE, Grip, RobotiqGripper
from spikingtac.robot.watchdog import Watchdog, WatchdogConfig, WatchdogThread
from spikingtac.stream.real_time import exempt_from_collection
from spikingtac.stream.windows import WatchedWindows

QUIET_WINDOWS = 4000  # Windows of the arm at rest from which the detector learns, 1 ms each.

# When a camera's stream counts as lost. The fastest touch then continues for 0.6 mm, or for 1.5
# mm, which is a force of 0.06 N at 0.04 N/mm.
LIVE = WatchdogConfig(stale_s=0.1, backlog_s=0.25)

# Wait after the gripper has closed, s: the gel has crept most of its way by then.
GRIP_SETTLE_S = 1.0
OPEN = 0  # Position of the open gripper.
ASSUMPTIONS_ON_ARM = (
    *ASSUMPTIONS,
    "delta_crit is the given one in every direction, its spread holds the arm's repeatability",
    "the bit's heading is unknown; its mean reach, 0.41 mm, was taken",
    "nothing touched during the first 4 s of the stream, from which the detector learnt",
)


def on_arm(args: Args) -> ProbedHole:
    """Search a hole with a UR arm, from where it stands.

    Raises:
        SearchError: There is no wall, no room, or no circle; the arm is at rest.
        DeviceError: Arm, gripper or sensor failed; the arm was commanded to stop.
    """
    assert args.calibration is not None
    calibration = Calibration.load(args.calibration)
    known = Compensation(travel_mm=args.travel_mm, travel_sigma_mm=args.travel_sigma_mm)
    travel, grip = TravelModel.of(known), None
    with ended_by_sigterm(), contextlib.ExitStack() as stack:
        gripper = stack.enter_context(connect_gripper(args)) if args.gripper else None
        if gripper is not None:
            grip = close_on_probe(gripper)
        circle, touches = _search_hole(args, calibration, travel, stack)
        if gripper is not None and args.release:
            gripper.move(OPEN)
    return ProbedHole(
        args=args,
        circle=circle,
        touches=touches,
        travel=travel,
        assumed=ASSUMPTIONS_ON_ARM,
        given={"events": str(args.events), "calibration": str(args.calibration)},
        grip=grip,
    )


def _search_hole(
    args: Args, calibration: Calibration, travel: TravelModel, stack: contextlib.ExitStack
) -> tuple[Circle, Sequence[Touched]]:
    """Learn from the quiet stream, connect the arm, and search under the watchdog."""
    arms: list[Arm] = []

    def stop() -> None:
        for arm in arms:
            arm.stop()

    def confirm() -> None:
        for arm in arms:
            arm.confirm_stop()

    watchdog = Watchdog(LIVE, stop, time.monotonic, confirm=confirm)
    stream, live = listen(args, calibration, watchdog)
    if live is not None:
        stack.callback(live.close)
    quiet = list(islice(stream, QUIET_WINDOWS))
    if not any(count_of(window) for window in quiet):  # a working sensor has noise and leak
        raise DeviceError(
            f"the sensor gave no event in its first {len(quiet)} windows of 1 ms: it is dead, "
            "covered or masked, or the stream is empty; check the camera, nothing was moved"
        )
    detector = make_detector(args.detector, DetectionConfig(), [calibration], quiet)
    if live is not None:
        exempt_from_collection()
    arm = connect(args)
    stack.callback(arm.close)
    arms.append(arm)
    if live is not None:
        watchdog.self_test()
        live.skip()
        watchdog.arm()
        stack.enter_context(WatchdogThread(watchdog))
    prober = ArmProber(arm, stream, detector, args.probing, watchdog)
    return search(args, prober, travel, prober.place_mm())


def connect_gripper(args: Args) -> RobotiqGripper:
    """Return the gripper of the arm's controller; DeviceError where it does not answer."""
    assert args.arm is not None
    return RobotiqGripper(args.arm)


def close_on_probe(gripper: RobotiqGripper) -> dict[str, Any]:
    """Close the gripper gently, and return the grip: ``object`` and ``position`` (0 to 255).

    Raises:
        DeviceError: The gripper holds nothing, reports a fault, or does not answer.
    """
    gripper.activate()
    found = gripper.move(FULL_SCALE)
    position = gripper.position()
    if found is not Grip.HELD_CLOSING:
        raise DeviceError(
            f"the gripper closed to position {position} of {FULL_SCALE} and holds nothing; "
            "put the probe between its fingers and start again"
        )
    time.sleep(GRIP_SETTLE_S)
    return {"object": "held", "position": position}


def connect(args: Args) -> Arm:
    """Return the arm, at rest.

    Raises:
        DeviceError: It does not answer.
        MissingExtraError: The extra ``[robot]`` is not installed.
    """
    from spikingtac.robot.ur import URArm

    assert args.arm is not None
    return URArm(args.arm)


def listen(
    args: Args, calibration: Calibration, watchdog: Watchdog
) -> tuple[Iterator[Window], WatchedWindows | None]:
    """Return the windows of the finger, 1 ms each, and of a camera what reads it in a thread.

    Raises:
        CalibrationError: The calibration belongs to a sensor of another size.
    """
    assert args.events is not None
    source = open_events(args.events)
    require_same_size(source.size, calibration.size)
    if is_stream(args.events):
        watched = WatchedWindows(source, watchdog)
        return iter(watched), watched
    return ((window,) for window in windows(source, period_us=1000)), None
