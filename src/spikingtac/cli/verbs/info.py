"""``spikingtac info``: the content of an event file, and its damage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from spikingtac.cli.interrupt import ending_on_interrupt
from spikingtac.cli.messages import Table, figures, progress, remark, tell
from spikingtac.cli.options import ReadArgs
from spikingtac.file_kinds import TOLD, document_of, kind_of

if TYPE_CHECKING:
    from spikingtac.events.formats.file_source import FileSource

PEAK_WINDOW_US = 1_000  # Window of the peak rate, us: that of contact detection.

US_PER_S = 1_000_000
EVENTS_PER_MEV = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Args(ReadArgs):
    """Print the content of an event file, of a recording folder, or of any file of this package."""

    file: tyro.conf.Positional[Path]
    """Event file, recording folder, or a camera: its address, a named pipe, or -. Also tracks.npz,
    truth.npz, calibration.json, a force model, report.json, or arrays of displacements."""
    encoding: Annotated[str | None, tyro.conf.arg(metavar="evt2|evt21|evt3")] = None
    """Encoding of a RAW file; it overrides the header."""


def run(args: Args) -> int:
    """Read the whole file once and print its content."""
    from spikingtac.events.open import open_events

    kind = kind_of(args.file)
    if kind is not None and kind in _FIGURES:
        told = {"format": kind, **_FIGURES[kind](args.file)}
        return tell(
            args.json, {**told, "about": TOLD[kind]}, figures(str(args.file), told), TOLD[kind]
        )
    source = open_events(args.file, strict=args.strict, sensor=args.sensor, encoding=args.encoding)
    found = summary(source)
    return tell(args.json, found, *(f"note: {note}" for note in source.notes), *_shown(args, found))


def _shown(args: Args, found: dict[str, Any]) -> list[Table | str]:
    """Return the figures of a recording for a reader."""
    from spikingtac.events.formats.codec import KINDS

    apart = {name: found[name] for name in ("anomalies", "trigger_channels")}
    health = {kind: count for kind, count in found["health"].items() if kind != "rate_ev_s"}
    plain = {name: value for name, value in found.items() if name not in apart}
    shown: list[Table | str] = [figures(str(args.file), plain | {"health": health})]
    if channels := apart["trigger_channels"]:
        rows = [(name, *one.values()) for name, one in channels.items()]
        shown.append(Table("triggers", ("channel", "edges", "first us", "last us"), rows))
    if anomalies := apart["anomalies"]:
        rows = [(kind, KINDS.get(kind, ""), count) for kind, count in anomalies.items()]
        shown.append(Table("anomalies", ("kind", "what it means", "times"), rows, words=2))
    elif not found["events"]:
        shown.append("the file holds no events")
    return shown


def _of_tracks(path: Path) -> dict[str, Any]:
    from spikingtac.tracks import Tracks

    return Tracks.load(path).summary()


def _of_truth(path: Path) -> dict[str, Any]:
    from spikingtac.events.formats.array_file import load_arrays

    truth = load_arrays(path, "ground truth")
    t_us = truth["marker_t_us"]
    return {
        "markers": truth["marker_px"].shape[1],
        "samples": len(t_us),
        "duration_s": _duration_s(t_us),
        "arrays": sorted(truth),
    }


def _of_series(path: Path) -> dict[str, Any]:
    from spikingtac.events.formats.array_file import load_arrays
    from spikingtac.tracks.columns import longest

    arrays = load_arrays(path, "displacements")
    t_us, moved, wrench = arrays["t_us"], arrays["displacement_mm"], arrays.get("wrench")
    return {
        "markers": moved.shape[1],
        "samples": len(t_us),
        "duration_s": _duration_s(t_us),
        "displacement_max_mm": longest(moved),
        "wrench_components": 0 if wrench is None else wrench.shape[1],
        "force_max_n": None if wrench is None else longest(wrench[:, :3]),
    }


def _duration_s(t_us: Any) -> float:
    return float(t_us[-1] - t_us[0]) / US_PER_S if len(t_us) else 0.0


def _of_force(path: Path) -> dict[str, Any]:
    document = document_of(path)
    return {
        "components": document.get("components"),
        "unit": document.get("unit"),
        "markers": len(document["reference"]) if "reference" in document else None,
    }


def _of_report(path: Path) -> dict[str, Any]:
    document = document_of(path)
    rows = [row for row in document["rows"] if isinstance(row, dict)]
    return {
        "experiment": document["experiment"],
        "rows": len(rows),
        **{
            f"{name}s": sorted({str(row.get(name)) for row in rows})
            for name in ("method", "case", "metric", "source")
        },
    }


def _of_manifest(path: Path) -> dict[str, Any]:
    document = document_of(path)
    return {name: value for name, value in document.items() if not isinstance(value, dict)}


def _of_calibration(path: Path) -> dict[str, Any]:
    """Return the figures of a calibration."""
    from spikingtac.calibration.sensor_calibration import Calibration

    calibration = Calibration.load(path)
    measured = calibration.marker_measured
    return {
        "size": list(calibration.size),
        "grid": calibration.rows_and_columns,
        "polarity": calibration.polarity,
        "quality": calibration.provenance.get("quality"),
        "markers_measured": None if measured is None else int(measured.sum()),
        "radius_px": float(calibration.radius_px.mean()),
        "lag_us": calibration.lag_us,
        "px_per_mm": calibration.px_per_mm,
        "lens": calibration.lens is not None,
        "recording": calibration.provenance.get("recording"),
    }


# Kind of a file of ours that holds no events -> its figures.
_FIGURES: dict[str, Callable[[Path], dict[str, Any]]] = {
    "tracks": _of_tracks,
    "truth": _of_truth,
    "series": _of_series,
    "calibration": _of_calibration,
    "force": _of_force,
    "report": _of_report,
    "manifest": _of_manifest,
}


def summary(source: FileSource) -> dict[str, Any]:
    """Read a source to its end and return its figures; times are None where there is no event."""
    events = ups = peak = 0
    first_us = last_us = None
    counter = _PeakCounter(PEAK_WINDOW_US)
    with ending_on_interrupt(source), progress(f"reading {source.path.name}") as advance:
        for packet in source:
            if first_us is None:
                first_us = packet.t_start_us
            last_us = int(packet.t[-1]) if len(packet) else last_us
            events += len(packet)
            ups += int(packet.p.sum())
            peak = counter.add(packet.t - first_us)
            advance(source.progress)
    duration_s = 0.0 if first_us is None or last_us is None else (last_us - first_us) / US_PER_S
    return {
        "format": source.format,
        "size": list(source.size),
        "events": events,
        "on_fraction": ups / events if events else None,
        "t_first_us": first_us,
        "t_last_us": last_us,
        "duration_s": duration_s,
        "mean_rate_mev_s": events / duration_s / EVENTS_PER_MEV if duration_s else 0.0,
        "peak_rate_mev_s": peak / PEAK_WINDOW_US * US_PER_S / EVENTS_PER_MEV,
        "triggers": len(source.triggers),
        "trigger_channels": source.triggers.channels(),
        "anomalies": dict(source.losses.kinds()),
        "health": source.counters().summary(),
        **_delivery(source),
        **_told_by_manifest(source, events),
    }


def _told_by_manifest(source: FileSource, events: int) -> dict[str, Any]:
    """Return what a recorder has noted beside its files, compared with them; nothing elsewhere."""
    from spikingtac.events.manifest import MANIFEST, read_manifest
    from spikingtac.events.open import RECORDING_NAME

    path = source.path.parent / MANIFEST
    noted = read_manifest(path) if source.path.name == RECORDING_NAME else {}
    if noted.get("source") != "camera" or not isinstance(noted.get("events"), int):
        return {}
    if events != noted["events"] and noted.get("complete"):
        remark(f"note: the manifest tells {noted['events']} events, the files hold {events}")
    losses = noted.get("losses")
    return {
        "manifest_events": noted["events"],
        "lost_events": noted.get("lost_events", 0),
        "recorded_losses": losses if isinstance(losses, dict) else {},
    }


def _delivery(source: FileSource) -> dict[str, Any]:
    """Return how a camera delivered; nothing of a file."""
    from spikingtac.events.camera_source import CameraSource

    if not isinstance(source, CameraSource):
        return {}
    health = source.health()
    remark(health.sentence)
    return {"interval_p50_ms": health.interval_p50_ms, "interval_p99_ms": health.interval_p99_ms}


class _PeakCounter:
    """The largest number of events in a window, for events in order of time."""

    def __init__(self, window_us: int) -> None:
        self._window_us = window_us
        self._window, self._count, self._peak = 0, 0, 0

    def add(self, t: Any) -> int:
        """Count more events, times from the first one on; return the peak so far."""
        import numpy as np

        if len(t):
            windows, counts = np.unique(t // self._window_us, return_counts=True)
            if windows[0] == self._window:
                counts[0] += self._count
            self._window, self._count = int(windows[-1]), int(counts[-1])
            self._peak = max(self._peak, int(counts.max()))
        return self._peak
