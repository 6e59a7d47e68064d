"""``spikingtac contact``: say when something touched, from raw events in 1 ms windows."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

import spikingtac as st
from spikingtac import contact, events, stream
from spikingtac.cli.messages import Table, counted, progress, remark, tell
from spikingtac.cli.options import RealtimeArgs
from spikingtac.cli.sources import (
    anomalies_of,
    ask_for_real_time,
    checked,
    ending_on_interrupt,
    fitting,
    open_two,
    require_live,
)
from spikingtac.events.recording import name_of

CALIBRATION = "calibration.json"
FALLBACK = (
    "note: no calibration was given or found, so raw events are counted as published; "
    "with --calibration the default detector finds lighter contacts"
)

IN_CONTACT = (
    "note: the recording begins in contact, or markers move at once. The thresholds were "
    "learned from its quietest 0.3 s; a recording without contact gives better ones: --quiet"
)

# Change of the mean displacement over 0.1 s, px, of so many markers that it is a contact: an arm
# shakes them to and fro, and more often. A camera's burst displaces them in the first 0.1 s only.
MOVED_PX, MOVED_MARKERS, MOVED_WINDOWS = 0.3, 3, 100


@dataclass(frozen=True, kw_only=True)
class Args(RealtimeArgs):
    """Find the contacts in a recording: not a safety function, see the how-to.

    The thresholds are learned from the beginning of the recording, which should be free of contact,
    or from a recording of the moving arm that is given with --quiet. Where markers move at once, or
    the beginning holds no event, the quietest 0.3 s with events serve. The default detector uses
    the rims of the markers and needs a calibration of each sensor; without one, raw events are
    counted.

    Attributes:
        recording: Event file, or recording folder of one or two sensors (events.raw, events_1.raw);
            a camera's address, a named pipe or - for events as they come, with --quiet.
        second: The other finger: its recording or camera, put on the first one's clock.
        calibration: calibration.json of each sensor; those beside the recording unless given.
        quiet: Recording of the moving arm without contact; the beginning of RECORDING unless given.
        preset: Settings of the detectors: a preset, or a TOML file with a table [contact].
        detector: default (signed evidence), event_count (as published), or another package's;
            default where there is a calibration, otherwise event_count, unless given.
        budget: Allowed false contacts per hour of free motion; the preset's (1) unless given.
        strict: Refuse damage and another sensor's calibration, instead of a repair or a warning.
    """

    recording: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RECORDING")]
    second: Annotated[Path | None, tyro.conf.arg(metavar="RECORDING")] = None
    calibration: tuple[Path, ...] = ()
    quiet: Path | None = None
    preset: str = "default"
    detector: str | None = None
    budget: float | None = None
    strict: bool = False


def run(args: Args) -> int:
    """Learn from the quiet windows, find the contacts, and report them."""
    config = _config(args)
    sources = _sources(args.recording, args.strict, args.second)
    calibrations = _calibrations(args, sources)
    counts_only = config.detector is None and not calibrations
    name = config.detector or ("event_count" if counts_only else "default")
    config = replace(config, detector=name)
    detector, first, learned_from = _learn(args, config, sources, calibrations)
    learned = detector.summary()
    pairs = zip(sources, calibrations, strict=False)
    seen: Sequence[Any] = [checked(*pair, args.strict) for pair in pairs] or sources
    if args.realtime:
        ask_for_real_time()
    found = _found(seen, detector, first)
    anomalies = anomalies_of(*sources)
    document = {
        "contacts": found,
        "detector": name,
        "sensors": len(sources),
        "budget_per_hour": config.false_alarms_per_hour,
        "rule": learned.rule,
        "quiet": _quiet(learned_from, learned),
        "anomalies": anomalies,
        "health": [source.counters().summary() for source in sources],
        "calibration_misfit": " ".join(filter(None, (getattr(one, "misfit", "") for one in seen)))
        or None,
    }
    notes = [FALLBACK] if counts_only else []
    table = _table(document, args.recording)
    return tell(args.json, document, *notes, *counted(anomalies), learned.rule, table)


def _config(args: Args) -> st.DetectionConfig:
    """Return the preset's settings with what the command line changes; refuse a mere stream."""
    require_live([args.recording], where=args.realtime)
    if events.is_stream(args.recording) and args.quiet is None:
        raise st.ConfigError(
            f"{str(args.recording)!r} is a stream and is read once, as it comes; give a recording "
            "of the moving arm without contact to learn from: --quiet RECORDING"
        )
    config = st.load_config(args.preset).contact
    budget = config.false_alarms_per_hour if args.budget is None else args.budget
    return replace(config, false_alarms_per_hour=budget, detector=args.detector or config.detector)


def _found(
    sources: Sequence[Any], detector: st.ContactDetector, first: int
) -> list[dict[str, Any]]:
    """Return the contacts; those of a camera are told as they come."""
    found, live = [], events.is_stream(sources[0].path)
    windows = stream.live_windows(sources) if live and len(sources) > 1 else None
    bar = progress(f"finding contacts in {sources[0].path.name}")
    with ending_on_interrupt(*sources), bar as advance:
        for one, end_us in contact.find_contacts(sources, detector, windows, first):
            found.append(asdict(one) | {"end_us": end_us})
            if live:
                remark(f"contact at {one.t_us} us")
            advance(sources[0].progress)
    return found


def _learn(
    args: Args,
    config: st.DetectionConfig,
    sources: Sequence[events.FileSource],
    calibrations: Sequence[st.Calibration],
) -> tuple[st.ContactDetector, int, str]:
    """Build the detector from the quiet windows.

    Returns:
        The detector; the first window that counts; and where the quiet windows come from.
    """
    given = sources if args.quiet is None else _sources(args.quiet, args.strict)[: len(sources)]
    if len(given) < len(sources):
        raise st.ConfigError(f"--quiet holds {len(given)} sensor, RECORDING holds {len(sources)}")
    for quiet, source in zip(given, sources, strict=False):
        if quiet.size != source.size:
            raise st.ConfigError(
                f"--quiet is from a sensor of {quiet.size[0]}x{quiet.size[1]} px, RECORDING from "
                f"one of {source.size[0]}x{source.size[1]} px; record both with the same sensor"
            )
    first, stretch, learned_from = 0, (0, None), "beginning"
    if args.quiet is not None:
        learned_from = args.quiet.name
    else:
        first, _ = stretch = contact.leading_quiet(sources)
        # Counts only: the events of two minutes may fill the memory.
        counts = list(map(contact.count_of, islice(contact.paired_windows(sources), *stretch)))
        begun = any(map(partial(_moves, first=first), sources, calibrations))
        begun = begun or contact.come_in_bursts(counts)
        if begun or not any(counts):
            first, stretch, learned_from = 0, contact.quietest(sources), "quietest"
        if begun:
            remark(IN_CONTACT)
    quiet = islice(contact.paired_windows(given), *stretch)
    detector = st.make_detector(config.detector or "default", config, calibrations, quiet)
    return detector, first, learned_from


def _moves(source: events.FileSource, calibration: st.Calibration, first: int) -> bool:
    """Return whether markers leave their rests by more than an arm shakes them.

    Args:
        source: The recording.
        calibration: Of its sensor.
        first: The first window that counts; a first contact may have passed for a camera's burst.
    """
    tracker = st.make_tracker(st.load_config("default").tracking, calibration)
    stream = st.windows(source, contact.WINDOW_US)
    places_px = []
    for window in islice(stream, first + contact.LEAST_QUIET_WINDOWS):
        tracker.absorb(window)
        places_px.append(tracker.estimate(window.t_end_us).displacement_px)
    ends = range(2 * MOVED_WINDOWS, len(places_px) + 1, MOVED_WINDOWS)  # without the first part
    means_px = np.array([np.mean(places_px[end - MOVED_WINDOWS : end], axis=0) for end in ends])
    moved_px = np.linalg.norm(means_px - means_px[:1], axis=2)
    return bool(((moved_px > MOVED_PX).sum(axis=1) >= MOVED_MARKERS).any())


def _quiet(source: str, learned: contact.DetectorSummary) -> dict[str, Any]:
    """Return the statistics of the quiet windows and the figures that they gave."""
    statistics: dict[str, Any] = {"source": source}
    if learned.quiet is not None:
        counts = asdict(learned.quiet)
        seconds = round(counts.pop("period_s") * learned.quiet.windows, 6)
        statistics |= {"seconds": seconds, **counts}
    return statistics | dict(learned.figures)


def _sources(path: Path, strict: bool, second: Path | None = None) -> list[events.FileSource]:
    if second is not None:
        return open_two(path, second, strict=strict)
    sensors = 2 if (path / name_of("events.raw", 1)).is_file() else 1
    return [st.open_events(path, strict=strict, sensor=sensor) for sensor in range(sensors)]


def _calibrations(args: Args, sources: Sequence[events.FileSource]) -> list[st.Calibration]:
    """Return the calibrations that are given, or else lie beside each recording."""
    if args.detector == "event_count":
        args.refuse("is not used by event_count, which counts all events", "calibration")
        return []
    if args.calibration and len(args.calibration) != len(sources):
        raise st.ConfigError(
            f"{len(args.calibration)} calibrations were given for {len(sources)} sensors; "
            "give one for each, in the sensors' order"
        )
    own = args.recording if args.recording.is_dir() else args.recording.parent
    other = args.second if args.second is not None and args.second.is_dir() else own
    beside = [own / CALIBRATION, other / (name_of(CALIBRATION, 1) if other == own else CALIBRATION)]
    paths = args.calibration or [path for path in beside[: len(sources)] if path.is_file()]
    if len(paths) != len(sources):
        return []
    return [fitting(path, source) for path, source in zip(paths, sources, strict=True)]


def _table(document: dict[str, Any], recording: Path) -> Table:
    # A camera is read once.
    packets = () if events.is_stream(recording) else st.open_events(recording)
    begin_us = next((int(packet.t[0]) for packet in packets if len(packet)), None)
    title = (
        f"{'contacts' if document['contacts'] else 'no contact'} in {recording.name} by "
        f"{document['detector']}, at most "
        f"{document['budget_per_hour']:g} false per hour; times from "
        f"{'zero' if begin_us is None else 'its first event'}"
    )
    if "mean" in (quiet := document["quiet"]):
        figures = "; quiet: {seconds:g} s, {mean:.2f} events/ms, variance {variance:.2f}"
        title += figures.format_map(quiet)
    rows = []
    for one in document["contacts"]:
        times_us = (one["t_us"], one["end_us"])
        times = ["-" if t is None else f"{(t - (begin_us or 0)) / 1e3:.1f}" for t in times_us]
        rows.append((*times, f"{one['count']:.0f}", f"{one['threshold']:.0f}"))
    return Table(title, ("t ms", "ends ms", "statistic", "threshold"), rows, words=0)
