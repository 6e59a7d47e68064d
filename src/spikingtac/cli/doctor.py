"""``spikingtac doctor``: what this machine has, lacks, and how to mend it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Annotated

import tyro

from spikingtac.cli.machine import delivery, inspect_machine
from spikingtac.cli.messages import Table, tell
from spikingtac.cli.options import JsonArgs
from spikingtac.errors import ConfigError

EXIT_MACHINE = 3


@dataclass(frozen=True, kw_only=True)
class Args(JsonArgs):
    """Check this machine: Python, kernel cache, extras, CPU governor, USB, cameras, clock, ports.

    With the address of a camera, also measure how it delivers.
    """

    source: Annotated[tyro.conf.Positional[str | None], tyro.conf.arg(metavar="[SOURCE]")] = None
    """Address of a camera to listen to, as openmv:/dev/ttyACM0."""
    seconds: float = 3.0
    """How long to listen to it, s."""


def run(args: Args) -> int:
    """Print the findings; exit 3 where something will not work."""
    if not args.seconds > 0.0:
        raise ConfigError(f"--seconds is {args.seconds:g}, it must be above 0")
    findings = list(inspect_machine())
    if args.source is not None:
        findings += delivery(args.source, args.seconds)
    healthy = all(finding.status != "fail" for finding in findings)
    document = {"healthy": healthy, "checks": [asdict(finding) for finding in findings]}
    rows = ((item.name, item.status, item.found, item.remedy) for item in findings)
    columns = ("check", "status", "found", "what to do")
    tell(args.json, document, Table("This machine", columns, rows, words=len(columns)))
    return 0 if healthy else EXIT_MACHINE
