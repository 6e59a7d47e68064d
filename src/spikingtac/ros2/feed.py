"""Where the frames that are published come from: tracks on disk, or events and a tracker."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.events.formats.file_source import FileSource
from spikingtac.events.windows import windows
from spikingtac.markers.registry import TrackingConfig, make_tracker
from spikingtac.pipeline.follow import CheckedSource, follow
from spikingtac.pipeline.track import require_same_size
from spikingtac.ros2.messages import Layout
from spikingtac.ros2.stream import SensorStream
from spikingtac.stream.reader import LiveSource
from spikingtac.touch.force.model import ForceModel
from spikingtac.tracks import Tracks
from spikingtac.types import EventPacket, MarkerFrame

US_PER_S = 1_000_000

# Span of a message of events, us: 100 per second, as event camera drivers send them.
EVENTS_US = 10_000
STEP_US = 1_000  # Step at which recordings are played, us.

# A frame, and its wrench where it is known.
Felt = tuple[MarkerFrame, NDArray[np.floating] | None]


class Pace:
    """Plays data at the speed at which they were recorded.

    Attributes:
        largest_lag_s: By how much data were late at most when they were asked for, s.
    """

    def __init__(self) -> None:
        self._zero_s: float | None = None  # host time of the data's zero
        self.largest_lag_s = 0.0

    def wait(self, t_us: int) -> None:
        """Return when data of this time are due, at once where they are late."""
        now_s = time.monotonic()
        if self._zero_s is None:
            self._zero_s = now_s - t_us / US_PER_S
        late_s = now_s - self._zero_s - t_us / US_PER_S
        if late_s < 0.0:
            time.sleep(-late_s)
        self.largest_lag_s = max(self.largest_lag_s, late_s)


@dataclass(frozen=True, kw_only=True)
class Feed:
    """Frames of a source.

    Attributes:
        layout: The markers at rest.
        source: The events, None where there are none.
        has_wrench: Whether the frames come with wrenches.
        frames: Yields the frames when they are due; events go to the stream meanwhile.
    """

    layout: Layout
    source: FileSource | None = None
    has_wrench: bool = False
    frames: Callable[[SensorStream, Pace], Iterator[Felt]]


def feed_of_tracks(
    tracks: Tracks, calibration: Calibration | None, force: ForceModel | None
) -> Feed:
    """Return the frames of tracks, at the speed of their recording.

    Raises:
        ConfigError: The calibration or the force model is of another sensor.
    """
    wrenches, rest_px = tracks.wrench, tracks.reference_px.astype(np.float64)
    wrench_of = _wrenches(force, rest_px)

    def frames(stream: SensorStream, pace: Pace) -> Iterator[Felt]:
        for number, frame in enumerate(tracks.frames()):
            pace.wait(frame.t_us)
            known = None if wrenches is None else wrenches[number]
            yield frame, known if wrench_of is None else wrench_of(frame)

    grid, size = tracks.meta.get("grid"), None
    if calibration is not None:
        if len(calibration.reference_px) != len(rest_px):
            raise ConfigError(
                f"the tracks have {len(rest_px)} markers, the calibration "
                f"{len(calibration.reference_px)}; give the one that they were tracked with"
            )
        grid, size = calibration.grid, calibration.size
    layout = Layout(rest_px, grid and (int(grid[0]), int(grid[1])), tracks.px_per_mm, size)
    felt = wrenches is not None or wrench_of is not None
    return Feed(layout=layout, has_wrench=felt, frames=frames)


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
        ConfigError: The force model is of another sensor.
        CalibrationError: The calibration is for another size.
    """
    tracker = make_tracker(tracking, calibration)
    require_same_size(events.size, calibration.size)
    checked = CheckedSource(events, calibration, tell)
    rest_px, scale = calibration.reference_px, calibration.px_per_mm
    wrench_of = _wrenches(force, rest_px)

    def frames(stream: SensorStream, pace: Pace) -> Iterator[Felt]:
        if isinstance(events, LiveSource):
            published = _published(checked, stream, lambda _: None)
        else:
            published = _published(windows(checked, STEP_US), stream, pace.wait)
        for frame in follow(published, tracker, tracking.rate_hz, events.losses):
            yield frame, None if wrench_of is None else wrench_of(frame)

    layout = Layout(rest_px, calibration.grid, scale, calibration.size)
    felt = wrench_of is not None
    return Feed(layout=layout, source=events, has_wrench=felt, frames=frames)


def _published(
    packets: Iterable[EventPacket], stream: SensorStream, wait: Callable[[int], None]
) -> Iterator[EventPacket]:
    """Yield packets when they are due, and publish their events, some milliseconds at a time."""
    kept: list[EventPacket] = []
    for packet in packets:
        wait(packet.t_end_us)
        kept.append(packet)
        if kept[-1].t_end_us - kept[0].t_start_us >= EVENTS_US:
            stream.events(EventPacket.concatenate(kept))
            kept = []
        yield packet
    if kept:
        stream.events(EventPacket.concatenate(kept))


def _wrenches(
    model: ForceModel | None, reference_px: NDArray[np.float64]
) -> Callable[[MarkerFrame], NDArray[np.floating]] | None:
    """Return what makes a wrench of every frame, where there is a force model."""
    if model is None:
        return None
    model.require(reference_px, "px")
    force = model.estimator()
    return lambda frame: force.update(frame.t_us, frame.detected_px - reference_px).values
