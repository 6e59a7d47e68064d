"""``spikingtac info``: the content of an event file, and its damage."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from numpy.typing import NDArray

import spikingtac as st
from spikingtac import events
from spikingtac.cli.messages import Table, figures, progress, remark, tell
from spikingtac.cli.options import ReadArgs
from spikingtac.cli.sources import anomalies_of, ending_on_interrupt
from spikingtac.events.formats.codec import KINDS
from spikingtac.events.recording import read_manifest
from spikingtac.file_kinds import RECORDING_NAME, TOLD, digest_of, document_of, kind_of
from spikingtac.touch.series import load_series
from spikingtac.tracks.tracks import longest
from spikingtac.types import US_PER_S

PEAK_WINDOW_US = 1_000  # Window of the peak rate, us: that of contact detection.


@dataclass(frozen=True, kw_only=True)
class Args(ReadArgs):
    """Print the content of an event file, of a recording folder, or of any file of this package.

    Attributes:
        file: Event file, recording folder, camera (address, named pipe, -), or a file of this
            package.
        encoding: Encoding of a RAW file; it overrides the header.
    """

    file: tyro.conf.Positional[Path]
    encoding: Annotated[str | None, tyro.conf.arg(metavar="evt2|evt21|evt3")] = None


def run(args: Args) -> int:
    """Read the whole file once and print its content."""
    kind = kind_of(args.file)
    if kind is not None and kind in _FIGURES:
        args.refuse(f"is for events, and {args.file.name} is {kind}", "encoding", "sensor")
        told = {"format": kind, **_FIGURES[kind](args.file)}
        document = {**told, "about": TOLD[kind]}
        return tell(args.json, document, figures(str(args.file), told), TOLD[kind])
    source = args.open(args.file, encoding=args.encoding)
    args.refuse("is for RAW files", "encoding", where=not source.format.startswith("EVT"))
    found = _summary(source)
    plain = dict(found)
    anomalies, channels = plain.pop("anomalies"), plain.pop("trigger_channels")
    plain["health"] = {kind: n for kind, n in plain["health"].items() if kind != "rate_ev_s"}
    shown: list[Table | str] = [*(f"note: {note}" for note in source.notes)]
    shown.append(figures(str(args.file), plain))
    if channels:
        rows = [(name, *one.values()) for name, one in channels.items()]
        shown.append(Table("triggers", ("channel", "edges", "first us", "last us"), rows))
    if anomalies:
        rows = [(kind, KINDS.get(kind, ""), count) for kind, count in anomalies.items()]
        shown.append(Table("anomalies", ("kind", "what it means", "times"), rows, words=2))
    elif not found["events"]:
        shown.append("the file holds no events")
    return tell(args.json, found, *shown)


def _of_truth(path: Path) -> dict[str, Any]:
    arrays = events.load_truth(path)
    t_us, markers = arrays["marker_t_us"], arrays["marker_px"].shape[1]
    told = {"markers": markers, "samples": len(t_us), "duration_s": _seconds(t_us)}
    return told | {"arrays": sorted(arrays)}


def _of_series(path: Path) -> dict[str, Any]:
    series = load_series(path)
    components = series.wrench.shape[1]
    return {
        "markers": len(series.reference),
        "samples": len(series.t_us),
        "duration_s": _seconds(series.t_us),
        "displacement_max_mm": longest(series.displacement),
        "wrench_components": components,
        "force_max_n": longest(series.wrench[:, :3]) if components else None,
    }


def _seconds(t_us: NDArray[np.int64]) -> float:
    return float(t_us[-1] - t_us[0]) / US_PER_S if len(t_us) else 0.0


def _of_document(path: Path) -> dict[str, Any]:
    """Return the plain values of a manifest, a force model or a report, and what its rows hold."""
    document = document_of(path)
    told = {
        name: value
        for name, value in document.items()
        if not isinstance(value[0] if isinstance(value, list) and value else value, dict | list)
    }
    if rows := [row for row in document.get("rows", ()) if isinstance(row, dict)]:
        names = ("method", "case", "metric", "source")
        told |= {f"{name}s": sorted({str(row.get(name)) for row in rows}) for name in names}
    return told | ({"rows": len(document["rows"])} if "rows" in document else {})


def _of_calibration(path: Path) -> dict[str, Any]:
    calibration = st.Calibration.load(path)
    measured = calibration.marker_measured
    same = ("polarity", "lag_us", "dead_time_us", "px_per_mm")
    return {
        "size": list(calibration.size),
        "grid": calibration.grid,
        **{name: calibration.provenance.get(name) for name in ("quality", "recording")},
        "markers_measured": None if measured is None else int(measured.sum()),
        "radius_px": float(calibration.radius_px.mean()),
        **{name: getattr(calibration, name) for name in same},
        "lens": calibration.lens is not None,
    }


# Kind of a file of ours that holds no events -> its figures.
_FIGURES: dict[str, Callable[[Path], dict[str, Any]]] = {
    "tracks": lambda path: st.Tracks.load(path).summary(),
    "truth": _of_truth,
    "series": _of_series,
    "calibration": _of_calibration,
    "force": _of_document,
    "report": _of_document,
    "manifest": _of_document,
}


def _summary(source: events.FileSource) -> dict[str, Any]:
    """Read a source to its end and return its figures; times are None where there is no event."""
    count = ups = peak = window = in_window = 0
    first_us = last_us = None
    with ending_on_interrupt(source), progress(f"reading {source.path.name}") as advance:
        for packet in source:
            first_us = packet.t_start_us if first_us is None else first_us
            if len(packet):
                last_us = int(packet.t[-1])
                windows, counts = np.unique(
                    (packet.t - first_us) // PEAK_WINDOW_US, return_counts=True
                )
                counts[0] += in_window if windows[0] == window else 0
                window, in_window = windows[-1], int(counts[-1])
                peak = max(peak, int(counts.max()))
            count += len(packet)
            ups += int(packet.p.sum())
            advance(source.progress)
    duration_s = 0.0 if first_us is None or last_us is None else (last_us - first_us) / US_PER_S
    return {
        "format": source.format,
        "size": list(source.size),
        "events": count,
        "on_fraction": ups / count if count else None,
        "t_first_us": first_us,
        "t_last_us": last_us,
        "duration_s": duration_s,
        "mean_rate_mev_s": count / duration_s / 1e6 if duration_s else 0.0,
        "peak_rate_mev_s": peak / PEAK_WINDOW_US,
        "triggers": len(source.triggers),
        "trigger_channels": source.triggers.channels(),
        "anomalies": anomalies_of(source),
        "health": source.counters().summary(),
        **_told_by_the_camera(source, count),
    }


def _told_by_the_camera(source: events.FileSource, count: int) -> dict[str, Any]:
    """Return how a camera delivers, or what its recorder noted; nothing of other files."""
    if isinstance(source, events.CameraSource):
        health = source.health()
        remark(health.sentence)
        return {name: getattr(health, name) for name in ("interval_p50_ms", "interval_p99_ms")}
    path = source.path.parent / events.MANIFEST
    noted = read_manifest(path) if source.path.name == RECORDING_NAME else {}
    if noted.get("source") != "camera" or not isinstance(noted.get("events"), int):
        return {}
    if count != noted["events"] and noted.get("complete"):
        remark(f"note: the manifest tells {noted['events']} events, the files hold {count}")
    parts = noted["files"] if isinstance(noted.get("files"), list) else []
    digests = {str(one.get("name")): one.get("sha256") for one in parts if isinstance(one, dict)}
    for file in sorted(path.parent.glob("events*.raw")):
        if digests.get(file.name) not in (None, digest_of(file)):
            remark(f"note: {file.name} is not what was recorded: its sha256 is another one")
    told = {"manifest_events": noted["events"], "lost_events": noted.get("lost_events", 0)}
    return told | {"recorded_losses": noted.get("losses") or {}}
