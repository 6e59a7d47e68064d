"""From a recording to tracks: in memory, or to a file of any length."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac._version import package_version
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import Config, load_config
from spikingtac.contact.detector import DetectorSummary, Window, packets_of
from spikingtac.errors import CalibrationError, ConfigError
from spikingtac.events.camera import is_stream
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.file_source import FileSource
from spikingtac.events.open import open_events
from spikingtac.events.source import refuse_path
from spikingtac.file_kinds import digest_of
from spikingtac.markers.registry import MarkerTracker, TrackingConfig, make_law, make_tracker
from spikingtac.markers.smoothing import smoothed
from spikingtac.pipeline.follow import CheckedSource, follow
from spikingtac.schema import to_mapping
from spikingtac.touch.force.model import ForceEstimator, ForceModel, Wrench
from spikingtac.tracks import Tracks, TracksWriter, create_tracks
from spikingtac.tracks.files import SIGMA
from spikingtac.types import Contact, EventPacket, FloatArray, MarkerFrame

PROGRESS_EVERY = 64  # Estimates between two reports of progress.


def track(
    source: str | Path | Iterable[EventPacket],
    calibration: str | Path | Calibration,
    preset: str | Path | Config = "default",
    *,
    rate_hz: float | None = None,
    hysteresis: str | None = None,
    smooth: bool = False,
) -> Tracks:
    """Track a whole recording and return every marker's displacement over time.

    Args:
        source: An event file, a recording folder, or packets such as :func:`spikingtac.open_events`
            and :class:`spikingtac.SceneSource` give.
        calibration: The sensor's calibration, or its file.
        preset: ``default``, ``fast`` or ``paper``, the path of a TOML file, or a configuration.
        rate_hz: Estimates per second of data time; the preset's unless given.
        hysteresis: Law of the output position: ``none``, ``paper`` or ``anchored``; the preset's
            unless given.
        smooth: Smooth backward once the whole recording is known, and tell ``sigma_px``.

    Returns:
        Estimates ``t_us (n,)`` with positions, displacements and confidence ``(n, m, ...)``.

    Raises:
        RecordingError: The recording cannot be read.
        CalibrationError: The calibration cannot be read, or is of a sensor of another size.
        ConfigError: The preset, the rate or the law is unknown, its tracker knows no smoothing, or
            the source is something else.

    Example:
        >>> tracks = track("press.raw", "calibration.json")  # doctest: +SKIP
        >>> tracks.displacement_px.shape  # doctest: +SKIP
        (4201, 64, 2)
    """
    if isinstance(calibration, str | Path):
        calibration = Calibration.load(calibration)
    config = preset if isinstance(preset, Config) else load_config(preset)
    tracking = config.with_tracking(
        rate_hz=rate_hz, hysteresis=hysteresis, smooth=smooth or None
    ).tracking
    packets = open_events(source) if isinstance(source, str | Path) else source
    refuse_path(packets)
    tracker = make_tracker(tracking, calibration)
    require_same_size(getattr(packets, "size", calibration.size), calibration.size)
    told = list(_told(follow(packets, tracker, tracking.rate_hz), tracker, tracking))
    tracks = Tracks.of([frame for frame, _ in told], calibration)
    if tracking.smooth:
        tracks = replace(tracks, sigma_px=np.array([more[SIGMA] for _, more in told], np.float32))
    losses = {k: int(n) for k, n in getattr(packets, "losses", {}).items()}
    triggers = getattr(packets, "triggers", Triggers()).columns()
    about = {"config": {"tracking": to_mapping(tracking)}, "losses": losses}
    meta = {**tracks.meta, **about, "package_version": package_version()}
    return replace(tracks, meta=meta, **triggers)


def track_to_file(
    source: FileSource | CheckedSource,
    output: str | Path,
    config: TrackingConfig,
    calibration: Calibration,
    advance: Callable[[float], None] = lambda share: None,
    force: ForceModel | None = None,
) -> dict[str, Any]:
    """Track a recording and write the tracks: at constant memory, unless they are smoothed.

    Args:
        source: The recording, from :func:`spikingtac.open_events`.
        output: ``.npz``, ``.csv`` or ``.parquet`` file to write.
        config: How markers are followed.
        calibration: The sensor's calibration.
        advance: Told the share that is done, 0 to 1.
        force: Tells the wrench of every frame, too.

    Returns:
        A summary: counts, largest displacement, markers never observed, anomalies, health, and
        what the recording has against the calibration.

    Raises:
        CalibrationError: The recording's size is not the calibration's.
        ConfigError: The force model is of another sensor, or the tracker knows no smoothing.
    """
    require_same_size(source.size, calibration.size)
    tracker = make_tracker(config, calibration)
    if force is not None:
        force.require(calibration.reference_px, "px")
    estimator = None if force is None else force.estimator()
    counts = _Counts(len(calibration.reference_px))
    checked = CheckedSource(source, calibration)
    with create_tracks(output, calibration.reference_px) as writer:
        _mark(writer, source, before=True)
        frames = follow(checked, tracker, config.rate_hz, checked.losses)
        for frame, more in _told(frames, tracker, config):
            if estimator:
                moved = frame.detected_px - calibration.reference_px
                more = {**more, **_columns(estimator.update(frame.t_us, moved))}
            writer.write(frame, more)
            counts.add(frame, more.get("force_n"))
            if counts.estimates % PROGRESS_EVERY == 0:
                advance(source.progress)
        _mark(writer, source, before=False)
        losses = dict(source.losses.kinds())
        found = {"health": source.counters().summary(), "calibration_misfit": checked.misfit}
        about = {"config": {"tracking": to_mapping(config)}, "losses": losses}
        read = {"input": source.path.name, "input_sha256": digest_of(source.path)}
        version = {"package_version": package_version()}
        writer.meta = {**about, **read, **version, **calibration.scale(), **found}
    return {
        **counts.summary(),
        "rate_hz": config.rate_hz,
        "anomalies": losses,
        **found,
        "output": str(output),
    }


def _told(
    frames: Iterable[MarkerFrame], tracker: MarkerTracker, config: TrackingConfig
) -> Iterator[tuple[MarkerFrame, dict[str, NDArray[Any]]]]:
    """Yield the frames, smoothed where that is asked for, and what else is known of each."""
    if not config.smooth:
        yield from ((frame, {}) for frame in frames)
        return
    for frame, sigma_px in smoothed(frames, tracker, make_law(config)):
        yield frame, {SIGMA: sigma_px}


def _mark(writer: TracksWriter, source: FileSource | CheckedSource, before: bool) -> None:
    """Tell the trigger edges, known once all has been read: tables need them before their rows."""
    if writer.marks_rows != before or (before and is_stream(source.path)):
        return
    if before:
        deque(source, maxlen=0)
    writer.triggers = source.triggers.columns()


def _columns(wrench: Wrench) -> dict[str, FloatArray]:
    """Return a wrench by the keys of a file."""
    torque = {"torque_nm": wrench.values[3:]} if len(wrench.values) > 3 else {}
    return {"force_n": wrench.force_n, "force_sigma_n": wrench.force_sigma_n, **torque}


def require_same_size(recorded: tuple[int, int], calibrated: tuple[int, int]) -> None:
    """Refuse a recording ``(width, height)`` that another sensor's calibration is used for.

    Raises:
        CalibrationError: The two sizes differ.
    """
    if recorded != calibrated:
        raise CalibrationError(
            f"the recording is {recorded[0]}x{recorded[1]}, the calibration is for "
            f"{calibrated[0]}x{calibrated[1]}; calibrate this sensor: "
            "spikingtac calibrate RECORDING -o calibration.json"
        )


class _Counts:
    def __init__(self, markers: int) -> None:
        self.estimates, self._coasted = 0, np.zeros(markers, np.int64)
        self._largest_px, self._largest_n = 0.0, 0.0

    def add(self, frame: MarkerFrame, force_n: FloatArray | None) -> None:
        if force_n is not None:
            self._largest_n = max(self._largest_n, float(np.linalg.norm(force_n)))
        self.estimates += 1
        self._coasted += frame.coasted
        largest2 = float((frame.displacement_px**2).sum(axis=1).max(initial=0.0))
        self._largest_px = max(self._largest_px, largest2**0.5)

    def summary(self) -> dict[str, Any]:
        never = np.flatnonzero(self._coasted == self.estimates) if self.estimates else []
        return {
            "markers": len(self._coasted),
            "estimates": self.estimates,
            "held_share": float(self._coasted.sum() / max(self.estimates * len(self._coasted), 1)),
            "displacement_max_px": self._largest_px,
            "force_max_n": self._largest_n or None,
            "never_observed": [int(marker) for marker in never],
        }


class ForceLimit:
    """Decides where the force on one sensor surely exceeds a limit: less its 90 % interval.

    It tracks the markers in every window, which costs more than to count events.

    Attributes:
        in_contact: True while the force exceeds the limit.
    """

    def __init__(self, tracker: MarkerTracker, estimator: ForceEstimator, limit_n: float) -> None:
        """Begin at the calibrated rest.

        Raises:
            ConfigError: The limit is not positive.
        """
        if not limit_n > 0.0:
            raise ConfigError(f"the limit of force is {limit_n:g} N, it must be positive")
        self._tracker, self._estimator, self._limit_n = tracker, estimator, limit_n
        self.in_contact = False

    def update(self, window: Window) -> Contact | None:
        """Follow the markers through the next window; return a contact where the force is large."""
        (packet,) = packets_of(window)
        self._tracker.absorb(packet)
        frame = self._tracker.estimate(packet.t_end_us)
        wrench = self._estimator.update(frame.t_us, frame.displacement_px)
        before, self.in_contact = self.in_contact, wrench.exceeds(self._limit_n)
        begins = self.in_contact and not before
        return Contact(frame.t_us, wrench.least_n, self._limit_n) if begins else None

    def reset(self) -> None:
        """Forget the past windows."""
        self._tracker.reset()
        self._estimator.reset()
        self.in_contact = False

    def summary(self) -> DetectorSummary:
        """Return the rule."""
        return DetectorSummary(rule=f"force, less its 90 % interval, above {self._limit_n:g} N")
