"""Where the frames that are published come from: tracks on disk, or events and a tracker."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.errors import ConfigError
from spikingtac.events.evt.raw_stream import is_stream
from spikingtac.events.formats.file_source import FileSource
from spikingtac.events.windows import windows
from spikingtac.markers.registry import make_tracker
from spikingtac.pipeline.checked_source import CheckedSource, refuse
from spikingtac.pipeline.follow import follow
from spikingtac.pipeline.track import require_same_size
from spikingtac.ros2.messages import Layout
from spikingtac.ros2.stream import SensorStream
from spikingtac.stream.sources import open_live
from spikingtac.touch.force.model import ForceEstimator, load_force
from spikingtac.tracks import Tracks, is_tracks_file
from spikingtac.types import EventPacket, MarkerFrame

US_PER_S = 1_000_000

# Span of a message of events: 100 per second, as event camera drivers send them.
EVENTS_US = 10_000
STEP_US = 1_000  # Step at which recordings are played.
LATENESSES = 65_536  # Frames whose lateness is kept: the last minute at 1 kHz.

# A frame, and its wrench where it is known already.
Felt = tuple[MarkerFrame, NDArray[np.floating] | None]


class Pace:
    """Plays data at the speed at which they were recorded, and knows how late they are."""

    def __init__(
        self,
        clock_s: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._clock_s, self._sleep = clock_s, sleep
        self._begun: tuple[int, float] | None = None
        self._late_us = np.zeros(LATENESSES, np.float32)
        self._sent = 0
        self.largest_lag_s = 0.0

    def wait(self, t_us: int) -> None:
        """Return when data of this time are due, at once where they are late."""
        if self._begun is None:
            self._begun = (t_us, self._clock_s())
        early_s = -self._late_s(t_us)
        if early_s > 0.0:
            self._sleep(early_s)
        self.largest_lag_s = max(self.largest_lag_s, -early_s)

    def sent(self, t_us: int) -> None:
        """Take note that the frame of this time has left."""
        if self._begun is not None:
            self._late_us[self._sent % LATENESSES] = self._late_s(t_us) * US_PER_S
            self._sent += 1

    def lateness_ms(self) -> dict[str, float]:
        """Return how late the last frames left, ms: ``p50``, ``p99`` and ``max``; may be empty."""
        late_ms = self._late_us[: min(self._sent, LATENESSES)] / 1e3
        if not len(late_ms):
            return {}
        p50, p99 = np.percentile(late_ms, (50, 99))
        figures = {"p50": p50, "p99": p99, "max": late_ms.max()}
        return {name: round(float(value), 3) for name, value in figures.items()}

    def _late_s(self, t_us: int) -> float:
        assert self._begun is not None
        first_us, begun_s = self._begun
        return self._clock_s() - begun_s - (t_us - first_us) / US_PER_S


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


@dataclass(frozen=True, kw_only=True)
class Feed:
    """Frames of a source.

    Attributes:
        layout: The markers at rest.
        source: The events, None where there are none.
        force: Makes a wrench of every frame, or None.
        has_wrench: Whether the frames come with wrenches.
        frames: Yields the frames when they are due; events go to the stream meanwhile.
    """

    layout: Layout
    source: FileSource | None
    force: ForceEstimator | None
    has_wrench: bool
    frames: Callable[[SensorStream, Pace], Iterator[Felt]]


def open_feed(config: FeedConfig) -> Feed:
    """Open a source.

    Raises:
        ConfigError: Events without calibration, or tracks and a calibration of another sensor.
        RecordingError: The source cannot be read.
    """
    calibration = None if config.calibration is None else Calibration.load(config.calibration)
    if config.source.is_file() and is_tracks_file(config.source):
        return _feed_of_tracks(config, calibration)
    if calibration is None:
        raise ConfigError(
            "events need the sensor's calibration: --calibration calibration.json; "
            "make one with: spikingtac calibrate RECORDING -o calibration.json"
        )
    return _feed_of_events(config, calibration)


def _feed_of_tracks(config: FeedConfig, calibration: Calibration | None) -> Feed:
    tracks = Tracks.load(config.source)
    wrenches = tracks.wrench

    def frames(stream: SensorStream, pace: Pace) -> Iterator[Felt]:
        for number, frame in enumerate(tracks.frames()):
            pace.wait(frame.t_us)
            yield frame, None if wrenches is None else wrenches[number]

    return Feed(
        layout=_layout_of_tracks(tracks, calibration),
        source=None,
        force=_force(config, tracks.reference_px.astype(np.float64)),
        has_wrench=wrenches is not None,
        frames=frames,
    )


def _feed_of_events(config: FeedConfig, calibration: Calibration) -> Feed:
    tracking = load_config(config.preset).with_tracking(rate_hz=config.rate_hz).tracking
    tracker = make_tracker(tracking, calibration)
    events = open_live(config.source, strict=config.strict, sensor=config.sensor)
    require_same_size(events.size, calibration.size)
    checked = CheckedSource(events, calibration, refuse if config.strict else config.tell)

    def frames(stream: SensorStream, pace: Pace) -> Iterator[Felt]:
        packets: Iterator[EventPacket] = iter(checked)
        if not is_stream(config.source):
            packets = _paced(windows(packets, STEP_US), pace)
        published = _publishing(packets, stream)
        for frame in follow(published, tracker, tracking.rate_hz, events.losses):
            yield frame, None

    return Feed(
        layout=Layout.of_image(
            calibration.reference_px, calibration.grid, calibration.size, calibration.px_per_mm
        ),
        source=events,
        force=_force(config, calibration.reference_px),
        has_wrench=False,
        frames=frames,
    )


def _paced(packets: Iterator[EventPacket], pace: Pace) -> Iterator[EventPacket]:
    """Yield packets at the times at which they were complete."""
    for packet in packets:
        pace.wait(packet.t_end_us)
        yield packet


def _publishing(packets: Iterator[EventPacket], stream: SensorStream) -> Iterator[EventPacket]:
    """Yield packets, and publish their events, some milliseconds at a time."""
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
    grid = tracks.meta.get("grid") or (1, len(rest_px))
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


def _force(config: FeedConfig, reference_px: NDArray[np.float64]) -> ForceEstimator | None:
    if config.force is None:
        return None
    model = load_force(config.force)
    model.require(reference_px, "px")
    return model.estimator()
