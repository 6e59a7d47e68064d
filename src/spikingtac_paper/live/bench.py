"""Faults and loads of the live runtime, in their long forms, each event accounted for (simulated).

``--quick`` runs the short forms, those of the suite. The page is the table of
docs/reference/live-faults.md with the figures of this machine.
"""

import tempfile
from pathlib import Path
from typing import Any

from spikingtac.config import digest
from spikingtac_paper.harness.report import Report, Row, write_report
from spikingtac_paper.harness.run import RunOptions, code_digest, kept
from spikingtac_paper.live.faults import FAULTS
from spikingtac_paper.live.loads import LOADS, run_load

NAME = "live"
DEFINITIONS = {
    "sent": "events that were sent to the camera's port",
    "kept": "events that can be read, or were taken",
    "lost": "events that were counted as lost, missed, or dropped by the kernel",
    "unaccounted": "sent less kept less lost: 0 where nothing is lost in silence",
    "recovered": "1 where it went on as the table says",
    "lost_by_kernel": "events of datagrams that the kernel says it dropped",
    "peak_mb": "most memory that the recorder held",
    "user_unaccounted": "published less taken less missed, of a plain user of the ring",
    "user_missed": "events that the plain user was too slow for",
    "frames_missed": "frames that the loop was too slow for",
    "loop_overflows": "events and datagrams that the loop's tracker was too slow for",
    "view_missed": "events that the view was too slow for",
    "loop_late_p50_ms": "median of how much later than the events a frame was made",
    "loop_late_p99_ms": "99th percentile of the same",
}
UNITS = {"peak_mb": "MB", "loop_late_p50_ms": "ms", "loop_late_p99_ms": "ms", "recovered": "1"}


def run(options: RunOptions) -> dict[str, Any]:
    """Run the bench, write its report, and return a summary."""
    settings = options.begin(bench=NAME, seed=options.seed)
    rows: list[Row] = []
    findings: list[str] = []
    names = [*FAULTS, *LOADS]
    for done, name in enumerate(names, 1):
        key = digest({"name": name, "settings": settings, "code": code_digest()})
        path = options.output / "parts" / f"{done}.json"
        part = kept(path, key, lambda name=name: _part(name, options.quick))
        findings.append(f"{name}: {part['figures']['unaccounted']} unaccounted; {part['seen']}")
        rows += [
            Row(method="live", case=name, metric=metric, value=value, n=1,
                unit=UNITS.get(metric, "events"), definition=DEFINITIONS[metric])
            for metric, value in part["figures"].items()
        ]  # fmt: skip
        options.report_progress(done, len(names))
    report = Report(
        title="The live runtime under faults and loads",
        settings=settings,
        rows=rows,
        first=names,
        findings=findings,
    )
    return write_report(report, options)


def _part(name: str, quick: bool) -> dict[str, Any]:
    """Cause a fault, or run a load."""
    with tempfile.TemporaryDirectory() as folder:
        if name in LOADS:
            seconds = LOADS[name].seconds[0 if quick else 1]
            return {"figures": run_load(LOADS[name], Path(folder), seconds), "seen": "loaded"}
        fault, short_s, long_s = FAULTS[name]
        found = fault(Path(folder), short_s if quick else long_s)
    counts = {"sent": found.sent, "kept": found.kept, "lost": found.lost}
    told = {"unaccounted": found.unaccounted, "recovered": int(found.recovered)}
    return {"figures": counts | told, "seen": found.seen}
