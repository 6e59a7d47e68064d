"""``spikingtac probe``: find centre and radius of one hole by touch, on the twin or a real arm."""

from __future__ import annotations

from typing import Any

from spikingtac.cli.messages import Table, tell
from spikingtac.cli.probe_search import Args, check


def run(args: Args) -> int:
    """Probe a hole, write the result, and print it."""
    from spikingtac.cli.verbs import probe_arm, probe_twin
    from spikingtac.cli.verbs.probe_result import output_paths, write

    check(args)
    paths = output_paths(args.output, args.overwrite)
    found = probe_arm.on_arm(args) if args.arm else probe_twin.on_twin(args)
    summary = found.summary() | (write(found, paths) if paths else {})
    return tell(args.json, summary, *_shown(summary))


def _shown(summary: dict[str, Any]) -> list[Table | str]:
    rows = [
        (name, summary[name], summary[f"{name}_sigma"], summary.get(f"{name}_error", "-"))
        for name in ("x_mm", "y_mm", "radius_mm")
    ]
    columns = ("", "estimate", "standard deviation", "error (simulated)")
    place = "simulated" if summary["simulated"] else "real arm"
    table = Table(f"hole from {summary['contacts']} contacts ({place})", columns, rows)
    written = [f"written: {summary['output']}, {summary['picture']}"] if "output" in summary else []
    return [table, *written]
