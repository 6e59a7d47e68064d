"""Where the frames that are published come from: tracks on disk, or events and a tracker."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.events.formats.file_source import FileSource
from spikingtac.markers.registry import TrackingConfig, make_tracker
from spikingtac.pipeline.follow import CheckedSource, check_rate, follow
from spikingtac.pipeline.track import require_same_size
from spikingtac.ros2.stream import SensorInfo, SensorStream
from spikingtac.stream.paced import Pace, PacedSource
from spikingtac.touch.force.model import ForceModel
from spikingtac.tracks import Tracks
from spikingtac.types import EventPacket, FloatArray, MarkerFrame

# Span of a message of events, us: 100 per second, as event camera drivers send them.
EVENTS_US = 10_000

# Frames of the rehearsal: rest, a press of 150 ms, and its release until it is told.
REHEARSED = 600
REHEARSED_STRAIN = 0.08  # Stretch of the skin in the rehearsal's press.

# A frame, and its wrench where it is known.
Felt = tuple[MarkerFrame, NDArray[np.floating] | None]


@dataclass(frozen=True, kw_only=True)
class Feed:
    """Frames of a source.

    Attributes:
        sensor: The sensor.
        source: The events, None where there are none.
        pace: Tells how late they are.
        frames: Yields the frames when they are due; events go to the stream meanwhile.
    """

    sensor: SensorInfo
    source: FileSource | None = None
    pace: Pace
    frames: Callable[[SensorStream], Iterator[Felt]]


def feed_of_tracks(
    tracks: Tracks, calibration: Calibration | None, force: ForceModel | None
) -> Feed:
    """Return the frames of tracks, at the speed of their recording.

    Raises:
        ConfigError: The calibration or the force model is of another sensor.
    """
    wrenches, rest_px = tracks.wrench, tracks.reference_px.astype(np.float64)
    felt, pace = _felt_by(force, rest_px), Pace()

    def frames(stream: SensorStream) -> Iterator[Felt]:
        for number, (frame, wrench) in enumerate(felt(tracks.frames())):
            pace.wait(frame.t_us)
            yield frame, wrench if wrenches is None or force is not None else wrenches[number]

    grid, size = tracks.meta.get("grid"), None
    if calibration is not None:
        if len(calibration.reference_px) != len(rest_px):
            raise ConfigError(
                f"the tracks have {len(rest_px)} markers, the calibration "
                f"{len(calibration.reference_px)}; give the one that they were tracked with"
            )
        grid, size = calibration.grid, calibration.size
    sensor = SensorInfo(
        rest_px,
        grid and (int(grid[0]), int(grid[1])),
        tracks.px_per_mm,
        size,
        has_wrench=wrenches is not None or force is not None,
    )
    return Feed(sensor=sensor, pace=pace, frames=frames)


def feed_of_events(
    events: FileSource,
    calibration: Calibration,
    tracking: TrackingConfig,
    force: ForceModel | None,
    tell: Callable[[str], None],
) -> Feed:
    """Return the frames that are tracked from events: live, or at the speed of their recording.

    Args:
        events: A camera or a recording.
        calibration: Of the sensor.
        tracking: Tracker and rate.
        force: Force model, or None.
        tell: Told once where the events contradict the calibration.

    Raises:
        ConfigError: The rate is out of range, or the force model of another sensor.
        CalibrationError: The calibration is for another size.
    """
    check_rate(tracking.rate_hz)
    tracker, rest_px = make_tracker(tracking, calibration), calibration.reference_px
    require_same_size(events.size, calibration.size)
    paced, felt = PacedSource(events), _felt_by(force, rest_px)
    checked = CheckedSource(paced, calibration, tell)

    def published(stream: SensorStream) -> Iterator[EventPacket]:
        """Yield packets; publish their events, some milliseconds at a time."""
        kept: list[EventPacket] = []
        for packet in checked:
            kept.append(packet)
            if packet.t_end_us - kept[0].t_start_us >= EVENTS_US:
                stream.events(EventPacket.concatenate(kept))
                kept = []
            yield packet
        if kept:
            stream.events(EventPacket.concatenate(kept))

    def frames(stream: SensorStream) -> Iterator[Felt]:
        return felt(follow(published(stream), tracker, tracking.rate_hz, events.losses))

    sensor = SensorInfo(
        rest_px,
        calibration.grid,
        calibration.px_per_mm,
        calibration.size,
        has_events=True,
        has_wrench=force is not None,
    )
    return Feed(sensor=sensor, source=events, pace=paced.pace, frames=frames)


def _felt_by(
    model: ForceModel | None, rest_px: FloatArray
) -> Callable[[Iterable[MarkerFrame]], Iterator[Felt]]:
    """Return what adds a wrench to every frame, where there is a force model."""
    if model is None:
        return lambda frames: ((frame, None) for frame in frames)
    model.require(rest_px, "px")
    force = model.estimator()
    return lambda frames: (
        (frame, force.update(frame.t_us, frame.detected_px - rest_px).values) for frame in frames
    )


def rehearse(sensor: SensorInfo) -> None:
    """Publish a press without readers, so that nothing is left to compile at the first frame.

    Without, the first frames leave late: by a second, measured on tracks of 64 markers.
    """
    rest_px = np.asarray(sensor.reference_px, np.float64)
    away_px = REHEARSED_STRAIN * (rest_px - rest_px.mean(axis=0))
    none, sure = np.zeros(len(rest_px), bool), np.ones(len(rest_px))
    stream = SensorStream(None, sensor)
    for step in range(REHEARSED):
        moved_px = away_px * (REHEARSED // 4 <= step < REHEARSED // 2)
        place_px = rest_px + moved_px
        stream.frame(MarkerFrame(step * 1_000, place_px, place_px, moved_px, none, sure))
