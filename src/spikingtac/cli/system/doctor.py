"""``spikingtac doctor``: what this machine has, lacks, and how to mend it."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from spikingtac.cli.messages import emit_json, emit_table
from spikingtac.cli.system.machine import inspect_machine

EXIT_MACHINE = 3


@dataclass(frozen=True, kw_only=True)
class Args:
    """Check this machine: Python, kernel cache, extras, CPU governor, USB, the viewer's port."""

    json: bool = False
    """Print one JSON object instead of a table."""


def run(args: Args) -> int:
    """Print the findings; exit 3 where something will not work."""
    findings = list(inspect_machine())
    healthy = all(finding.status != "fail" for finding in findings)
    if args.json:
        emit_json({"healthy": healthy, "checks": [asdict(finding) for finding in findings]})
    else:
        rows = ((item.name, item.status, item.found, item.remedy) for item in findings)
        columns = ("check", "status", "found", "what to do")
        emit_table("This machine", columns, rows, words=len(columns))
    return 0 if healthy else EXIT_MACHINE
