"""``spikingtac guard``: watch a camera's stream and stop an arm at the first contact."""

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import tyro

import spikingtac as st
from spikingtac import contact, events, robot
from spikingtac.cli.messages import remark, tell
from spikingtac.cli.options import JsonArgs
from spikingtac.cli.sources import checked, fitting
from spikingtac.errors import named

POLL_S = 0.02  # Time between two looks at the state of the guarding process, s.

# Age of the last state of a guard that watches at which it counts as stalled, s; it is renewed
# every 0.02 s, and its own watchdog has tripped by then unless it hangs.
SILENCE_S = 0.15

# Wait for the camera or the arm after which the user is told what is waited for, s.
WAITING_S = 2.0
ENDED = ("ended", "failed")  # Phases after which the guarding process does nothing more.
TRIPPED_S = 0.5  # Wait after a trip for the end of the guarding process, s: its loop may hang.
WARM_UP_WINDOWS = 500  # Quiet windows that load all kernels before an arm moves, 0.5 s.
NOT_A_SAFETY_FUNCTION = (
    "note: this is no safety function: it does not replace the robot's protective stop"
)
NO_PRECEDENCE = (
    "note: the system does not give the guard real-time priority, so that other work on this "
    "machine may stop the arm; permit it with a line in /etc/security/limits.conf: USER - rtprio 20"
)


@dataclass(frozen=True, kw_only=True)
class Args(JsonArgs):
    """Watch a camera's stream and stop a moving UR arm at the first contact.

    Another program moves the arm. The arm is also stopped when the stream ends, stalls or lags
    behind. This is not a safety function: it does not replace the robot's protective stop.

    Attributes:
        arm: Address of the UR arm, or twin: for a simulated one.
        events: The finger's camera: its address, or a named pipe with RAW events.
        calibration: calibration.json of that finger.
        quiet: Recording of the moving arm without contact, from which the detector learns.
        detector: Contact detector: default (signed, sequential) or event_count (as published).
        budget: Accepted number of false contacts per hour of free motion.
        force: force.onnx of that finger, for --limit-n.
        limit_n: Stop where the force surely exceeds this, N, instead of at the first contact.
    """

    arm: str
    events: Path
    calibration: Path
    quiet: Path
    detector: Annotated[str, tyro.conf.arg(metavar="default|event_count")] = "default"
    budget: float = 1.0
    force: Path | None = None
    limit_n: float | None = None


def run(args: Args) -> int:
    """Guard the arm until a contact or a fault, and print which.

    Raises:
        ConfigError: An argument is not valid; nothing was connected.
        SpikingTacError: Calibration or quiet recording cannot be read, or do not belong together;
            nothing was connected.
        DeviceError: The stream or the arm failed; the arm was commanded to stop. Before an arm is
            reached, its exit code says whose fault it is.
    """
    named(contact.detectors(), args.detector, "contact detector")
    if (args.force is None) != (args.limit_n is None):
        raise st.ConfigError("--force and --limit-n belong together: give both, or neither")
    args.refuse("is for contacts", "detector", "budget", where=args.force is not None)
    if not events.is_stream(args.events):
        raise st.ConfigError(
            f"--events is {str(args.events)!r}, it must be a camera's named pipe or address; "
            "to find the contacts in a recording: spikingtac contact RECORDING"
        )
    remark(NOT_A_SAFETY_FUNCTION)
    with contextlib.closing(start(args)) as process:
        status = _wait(process)
    found = status["contact"] if status["phase"] == "ended" else None
    if found is not None and not status.get("stop_failure"):
        names = ("contact", "latency", "windows", "health", "leaps", "losses")
        told = f"contact at {found['t_us']} us, the arm was stopped"
        if args.limit_n is not None:
            told = f"{found['count']:.2f} N at {found['t_us']} us, the arm was stopped"
        return tell(args.json, {name: status[name] for name in names}, told)
    failure = st.DeviceError(failure_text(status))
    failure.exit_code = status.get("code") or failure.exit_code
    raise failure


def failure_text(status: dict[str, Any]) -> str:
    """Return how a guard ended that ended badly: what became of the arm, and why."""
    if not status.get("connected"):
        return f"no arm was reached, nothing was stopped: {status['reason']}"
    if status.get("stop_failure"):
        return f"the arm was NOT stopped: {status['reason']}: {status['stop_failure']}"
    return f"the guard stopped the arm without a contact: {status['reason']}"


def start(args: Args) -> robot.ContactProcess:
    """Start the process that watches the stream and stops the arm.

    Files that the process could not learn from are refused before an arm is connected.
    """
    fitting(args.calibration, st.open_events(args.quiet))
    learning: dict[str, Any] = {"calibration": str(args.calibration), "quiet": str(args.quiet)}
    if args.force is None:
        learning |= {"name": args.detector, "budget": args.budget}
    else:
        learning |= {"force": str(args.force), "limit_n": args.limit_n}
    return robot.ContactProcess(
        partial(robot.stream_arrivals, path=str(args.events)),
        partial(force_limit if args.force else learnt_detector, **learning),
        partial(st.open_arm, address=args.arm),
    )


def learnt_detector(name: str, calibration: str, quiet: str, budget: float) -> st.ContactDetector:
    """Build a detector from a quiet recording; the guarding process calls this.

    Args:
        name: Name of the detector.
        calibration: Path of the finger's calibration.
        quiet: Path of the quiet recording.
        budget: Accepted number of false contacts per hour.
    """
    config, source = st.DetectionConfig(false_alarms_per_hour=budget), st.open_events(quiet)
    own = st.Calibration.load(calibration)
    # The recording tells whose calibration it is; the stream is not asked while it guards an arm.
    seen = checked(source, own, strict=False)
    return st.make_detector(name, config, [own], contact.paired_windows([seen]))


def force_limit(calibration: str, quiet: str, force: str, limit_n: float) -> st.ContactDetector:
    """Build a limit of force; the guarding process calls this.

    Args:
        calibration: Path of the finger's calibration.
        quiet: Path of the quiet recording.
        force: Path of the force model.
        limit_n: Force at which the arm stops, N.
    """
    from spikingtac.pipeline.track import ForceLimit

    own, model = st.Calibration.load(calibration), st.load_force(force)
    model.require(own.reference_px, "px", "the calibration")
    tracker = st.make_tracker(st.load_config("fast").tracking, own)
    limit = ForceLimit(tracker, model.estimator(), limit_n)
    for window in islice(contact.paired_windows([st.open_events(quiet)]), WARM_UP_WINDOWS):
        limit.update(window)
    limit.reset()
    return limit


def _wait(process: robot.ContactProcess) -> dict[str, Any]:
    """Return the last state of the guarding process, after a contact or a fault.

    Raises:
        DeviceError: The process died, or does not answer.
    """
    told: set[str] = set()
    while True:
        alive = process.alive()  # before the state: a process that has ended left its last one
        status = process.status()
        phase = status.get("phase")
        if phase in ENDED:
            return status
        if not alive:
            raise st.DeviceError(
                "the guarding process died; the controller's own watchdog stops the arm: check both"
            )
        age_s = time.monotonic() - status["at_s"] if status else 0.0
        if phase == "tripped" and age_s > TRIPPED_S:
            return status
        if phase == "ready" and age_s > SILENCE_S:
            why = "the guarding process does not answer; see whether the arm stands"
            remark(f"{why}; ending it now")  # before the wait for its end
            raise st.DeviceError(f"{why}, then start again")
        for text in _news(status, age_s):
            if text not in told:
                told.add(text)
                remark(text)
        time.sleep(POLL_S)


def _news(status: dict[str, Any], age_s: float) -> Iterator[str]:
    """Yield what a state says: what is waited for, that the guard watches, what is lost."""
    phase = status.get("phase")
    if phase == "starting" and age_s > WAITING_S:
        yield f"waiting for {status['reason']}"
    if phase == "tripped":
        yield f"tripped: {status['reason']}"
    if phase != "ready":
        return
    yield "watching: the self-test has told the arm to stop; start its motion now"
    if not status.get("precedes", False):
        yield NO_PRECEDENCE
    yield from (f"the stream: {kind} {n}" for kind, n in status.get("losses", {}).items() if n)
    if leaps := status.get("leaps", 0):
        yield f"the sensor's clock leapt ahead, {leaps} times so far"
