"""Where the frames that are published come from: tracks on disk, or events and a tracker."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.errors import ConfigError
from spikingtac.events.formats.evt.raw_stream import is_stream
from spikingtac.events.formats.file_source import FileSource
from spikingtac.events.open import open_events
from spikingtac.events.windows import windows
from spikingtac.markers.registry import make_tracker
from spikingtac.markers.tracker import MarkerTracker
from spikingtac.markers.tracking_config import TrackingConfig
from spikingtac.pipeline.checked_source import CheckedSource, refuse
from spikingtac.pipeline.follow import follow
from spikingtac.pipeline.recording_tracks import require_same_size
from spikingtac.ros2.messages import Layout
from spikingtac.ros2.pace import Pace, paced
from spikingtac.ros2.settings import LiveConfig, Settings
from spikingtac.ros2.stream import SensorStream
from spikingtac.touch.force.files.model_file import load_force
from spikingtac.touch.force.model import ForceEstimator
from spikingtac.tracks import Tracks, is_tracks_file
from spikingtac.types import EventPacket, MarkerFrame

EVENTS_US = 10_000
"""Span of a message of events: 100 per second, as event camera drivers send them."""
STEP_US = 1_000
"""Step at which recordings are played."""

Felt = tuple[MarkerFrame, NDArray[np.floating] | None]
"""A frame, and its wrench where it is known already."""


@dataclass(frozen=True, kw_only=True, slots=True)
class FeedConfig:
    """What is read, and how.

    Attributes:
        source: A camera's address, a recording, or tracks.
        calibration: The sensor's calibration; events need one.
        preset: Tracker.
        rate_hz: Frames per second; None takes the preset's.
        force: Force model, or None.
        sensor: In a folder, the sensor to read.
        strict: Refuse a damaged recording, and the calibration of another sensor.
        tell: Told once where the events contradict the calibration.
    """

    source: Path
    calibration: Path | None = None
    preset: str = "default"
    rate_hz: float | None = None
    force: Path | None = None
    sensor: int = 0
    strict: bool = False
    tell: Callable[[str], None] = lambda why: None


class Feed(Protocol):
    """Frames of a source.

    Attributes:
        layout: The markers at rest.
        source: The events, None where there are none.
        force: Makes a wrench of every frame, or None.
        has_wrench: Whether the frames come with wrenches.
        settings: What can be changed while it is published.
    """

    layout: Layout
    source: FileSource | None
    force: ForceEstimator | None
    has_wrench: bool
    settings: Settings

    def reset(self) -> bool:
        """Forget all but the calibration before the next frame; False for tracks: nothing is."""
        ...

    def frames(self, stream: SensorStream, pace: Pace) -> Iterator[Felt]:
        """Yield the frames when they are due; events go to the stream meanwhile."""
        ...


def open_feed(config: FeedConfig) -> Feed:
    """Open a source.

    Raises:
        ConfigError: Events without calibration, or tracks and a calibration of another sensor.
        RecordingError: The source cannot be read.
    """
    calibration = None if config.calibration is None else Calibration.load(config.calibration)
    if config.source.is_file() and is_tracks_file(config.source):
        return _TracksFeed(config, calibration)
    if calibration is None:
        raise ConfigError(
            "events need the sensor's calibration: --calibration calibration.json; "
            "make one with: spikingtac calibrate RECORDING -o calibration.json"
        )
    return _EventsFeed(config, calibration)


class _TracksFeed:
    """Frames of tracks.npz."""

    source: FileSource | None = None

    def __init__(self, config: FeedConfig, calibration: Calibration | None) -> None:
        self._tracks = Tracks.load(config.source)
        self.layout = _layout_of_tracks(self._tracks, calibration)
        self.force = _force(config, len(self._tracks.reference_px))
        self.has_wrench = self._tracks.wrench_estimate is not None
        self.settings = Settings(LiveConfig(), {"source": config.source.name})

    def reset(self) -> bool:
        return False

    def frames(self, stream: SensorStream, pace: Pace) -> Iterator[Felt]:
        wrenches = self._tracks.wrench_estimate
        for number, frame in enumerate(self._tracks.frames()):
            pace.wait(frame.t_us)
            yield frame, None if wrenches is None else wrenches[number]


class _EventsFeed:
    """Frames that a tracker makes of events."""

    has_wrench = False

    def __init__(self, config: FeedConfig, calibration: Calibration) -> None:
        self._tracking = load_config(config.preset).with_tracking(rate_hz=config.rate_hz).tracking
        self._calibration = calibration
        self._tracker = _Exchangeable(make_tracker(self._tracking, calibration))
        self.settings = Settings(
            LiveConfig(tracking=self._tracking), self._fixed(config), self._other_tracker
        )
        self.force = _force(config, len(calibration.reference_px))
        self._events = open_events(config.source, strict=config.strict, sensor=config.sensor)
        self.source: FileSource | None = self._events
        require_same_size(self._events.size, calibration.size)
        self._live = is_stream(config.source)
        self._checked = CheckedSource(self._events, calibration, self._tell(config))
        self.layout = Layout.of_image(
            calibration.reference_px, calibration.grid, calibration.size, calibration.px_per_mm
        )

    @staticmethod
    def _tell(config: FeedConfig) -> Callable[[str], None]:
        return refuse if config.strict else config.tell

    def _fixed(self, config: FeedConfig) -> dict[str, str | float]:
        named = {"source": str(config.source), "preset": config.preset}
        return {**named, "rate_hz": self._tracking.rate_hz}

    def _other_tracker(self, tracking: TrackingConfig) -> Callable[[], None]:
        """Return what makes another tracker take over: it begins with the skin at rest."""
        tracker = make_tracker(tracking, self._calibration)
        return lambda: self._tracker.exchange(tracker)

    def reset(self) -> bool:
        self.settings.later(self._tracker.reset)
        return True

    def frames(self, stream: SensorStream, pace: Pace) -> Iterator[Felt]:
        packets: Iterator[EventPacket] = iter(self._checked)
        if not self._live:
            packets = paced(windows(packets, STEP_US), pace)
        told, rate_hz = _telling(packets, stream), self._tracking.rate_hz
        for frame in follow(told, self._tracker, rate_hz, self._events.losses):
            yield frame, None


class _Exchangeable:
    """A tracker that another one can take over from, between two estimates."""

    def __init__(self, tracker: MarkerTracker) -> None:
        self.exchange(tracker)

    def exchange(self, tracker: MarkerTracker) -> None:
        self.absorb, self.estimate = tracker.absorb, tracker.estimate
        self.reset = tracker.reset


def _telling(packets: Iterator[EventPacket], stream: SensorStream) -> Iterator[EventPacket]:
    """Yield packets, and publish them, some milliseconds at a time."""
    kept: list[EventPacket] = []
    for packet in packets:
        kept.append(packet)
        if kept[-1].t_end_us - kept[0].t_start_us >= EVENTS_US:
            stream.events(EventPacket.concatenate(kept))
            kept = []
        yield packet
    if kept:
        stream.events(EventPacket.concatenate(kept))


def _layout_of_tracks(tracks: Tracks, calibration: Calibration | None) -> Layout:
    rest_px, scale = tracks.reference_px.astype(float), tracks.px_per_mm
    grid = tuple(tracks.meta.get("grid", (1, len(rest_px))))
    if calibration is not None:
        if len(calibration.reference_px) != len(rest_px):
            raise ConfigError(
                f"the tracks have {len(rest_px)} markers, the calibration "
                f"{len(calibration.reference_px)}; give the one that they were tracked with"
            )
        return Layout.of_image(rest_px, calibration.grid, calibration.size, scale)
    # Tracks do not know the image: the middle of their markers stands for its centre.
    middle = (rest_px.min(axis=0) + rest_px.max(axis=0)) / 2
    return Layout(rest_px, (int(grid[0]), int(grid[1])), (middle[0], middle[1]), scale)


def _force(config: FeedConfig, markers: int) -> ForceEstimator | None:
    if config.force is None:
        return None
    model = load_force(config.force)
    model.require_image(markers)
    return model.estimator()
