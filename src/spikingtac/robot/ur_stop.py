"""The means to stop a UR arm, the gentlest first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from spikingtac.robot.ur_ports import dashboard, send_script
from spikingtac.robot.verified_stop import Means, Report, StopConfig, VerifiedStop

PROTECT = "def spikingtac_protect():\n  protective_stop()\nend\n"
"""Program that makes the controller stop the arm as on a limit of force."""


@dataclass(frozen=True, kw_only=True)
class StopLink:
    """What a stop needs of one controller.

    Attributes:
        host: Its address.
        by_control_script: Gives the control script a stop; returns False where there is none.
        hush: Ends the heartbeat, so that the controller's own watchdog stops the arm, too.
        report: Returns the arm's last report.
        limit_s: Longest wait for a port, s.
    """

    host: str
    by_control_script: Callable[[], bool]
    hush: Callable[[], None]
    report: Callable[[], Report]
    limit_s: float


def verified_stop(
    link: StopLink, config: StopConfig, power_off: bool, clock_s: Callable[[], float]
) -> VerifiedStop:
    """Return what stops the arm of one controller.

    ``stopl`` in the control script; a program on the script port, which ends whatever program runs;
    a protective stop, and the dashboard's ``stop``, since the dashboard has no command for a
    protective one; at last, where the arm is seen to move, its power is switched off.

    Args:
        link: The controller.
        config: When the arm counts as stopped.
        power_off: Whether the last resort is used.
        clock_s: A monotonic clock, s.
    """
    host, limit_s = link.host, link.limit_s
    brake = f"def spikingtac_stop():\n  stopl({config.deceleration_m_s2})\nend\n"

    def gently() -> None:
        if not link.by_control_script():
            send_script(host, brake, limit_s)

    def by_own_script() -> None:
        link.hush()
        send_script(host, brake, limit_s)

    def by_protective_stop() -> None:
        send_script(host, PROTECT, limit_s)
        dashboard(host, "stop", limit_s)

    return VerifiedStop(
        (
            Means("a stop", gently),
            Means("a stop script", by_own_script),
            Means("a protective stop", by_protective_stop),
        ),
        link.report,
        config,
        Means("power off", lambda: dashboard(host, "power off", limit_s)) if power_off else None,
        clock_s,
    )
