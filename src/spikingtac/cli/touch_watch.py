"""What ``spikingtac touch`` watches: frames of a recording, a camera or arrays, and their scale."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikingtac.calibration.lens import SkinScale
from spikingtac.cli.interrupt import ending_on_interrupt
from spikingtac.cli.many import ManyArgs
from spikingtac.cli.messages import warn
from spikingtac.errors import ConfigError, RecordingError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from spikingtac.events.formats.file_source import FileSource
    from spikingtac.touch.ageing import Swing
    from spikingtac.touch.force.series import WrenchSeries
    from spikingtac.types import MarkerFrame


@dataclass(frozen=True, kw_only=True)
class WatchArgs(ManyArgs):
    """Options of the verb that say how to watch."""

    calibration: Path | None = None
    """calibration.json of this sensor; make one with: spikingtac calibrate."""
    preset: str = "default"
    """Tracker: default, fast or paper, or a TOML file."""
    rate_hz: float | None = None
    """Estimates per second; the preset's unless given."""
    vibration: bool = False
    """Report the strongest line of vibration in every second, from the markers' mean motion."""


@dataclass(frozen=True, slots=True)
class Watched:
    """Frames with what is needed to read them; lengths are in ``unit``."""

    frames: Iterator[MarkerFrame]
    reference: Any
    unit: str
    scale: SkinScale | None
    anomalies: dict[str, int]
    health: dict[str, float]
    rate_hz: float
    swing: Callable[[], Swing | None] = lambda: None

    @property
    def px_per_mm(self) -> float | None:
        """The mean scale, 1 where the unit is mm, None where it is not known."""
        return None if self.scale is None else self.scale.px_per_mm


def watch(args: WatchArgs, path: Path, advance: Callable[[float], None]) -> Watched:
    """Return the frames of a recording, of tracks, or of arrays.

    Args:
        args: How to watch.
        path: The file, folder or camera.
        advance: Receives the share that was read, 0 to 1.

    Raises:
        ConfigError: Events without a calibration.
    """
    from spikingtac.touch.force.series import is_series, load_series

    if is_series(path):
        series = load_series(path).in_image()
        in_mm = series.unit == "mm"
        return Watched(
            _frames_of(series),
            series.reference,
            series.unit,
            SkinScale(1.0) if in_mm else _scale_in_image(args, path),
            {},
            {},
            _rate_hz(series.t_us),
        )
    if args.calibration is None:
        raise ConfigError(
            "events need the sensor's calibration: --calibration calibration.json; "
            "make one with: spikingtac calibrate RECORDING -o calibration.json"
        )
    from spikingtac.events.open import open_events

    source = open_events(path, strict=args.strict, sensor=args.sensor)
    return track(args, source, args.calibration, advance)


def track(
    args: WatchArgs,
    source: FileSource,
    calibration_path: Path,
    advance: Callable[[float], None] = lambda share: None,
) -> Watched:
    """Return the frames that a tracker makes of events; see :func:`watch`."""
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.config import load_config
    from spikingtac.markers.registry import make_tracker
    from spikingtac.pipeline.checked_source import CheckedSource, refuse
    from spikingtac.pipeline.follow import follow
    from spikingtac.pipeline.track import require_same_size
    from spikingtac.touch.ageing import SwingRuns

    calibration = Calibration.load(calibration_path)
    config = load_config(args.preset).with_tracking(rate_hz=args.rate_hz, hysteresis="none")
    require_same_size(source.size, calibration.size)
    tracker, rate_hz = make_tracker(config.tracking, calibration), config.tracking.rate_hz
    checked = CheckedSource(source, calibration, refuse if args.strict else warn)
    runs = SwingRuns(calibration)
    anomalies: dict[str, int] = {}
    health: dict[str, float] = {}

    def frames() -> Iterator[MarkerFrame]:
        with ending_on_interrupt(source):
            packets = runs.passing(checked)
            for index, frame in enumerate(follow(packets, tracker, rate_hz, checked.losses)):
                runs.follow(frame.detected_px - calibration.reference_px)
                if index % PROGRESS_EVERY == 0:
                    advance(source.progress)
                yield frame
        anomalies.update(source.losses.kinds())
        health.update(source.counters().summary())

    told = (anomalies, health, rate_hz, runs.swing)
    return Watched(frames(), calibration.reference_px, "px", calibration.skin_scale, *told)


def _frames_of(series: WrenchSeries) -> Iterator[MarkerFrame]:
    """Yield the frames of a series that was measured by another sensor."""
    import numpy as np

    from spikingtac.types import MarkerFrame

    markers = len(series.reference)
    for t_us, moved in zip(series.t_us, series.displacement, strict=True):
        place = series.reference + moved
        seen, sure = np.zeros(markers, np.bool_), np.ones(markers)
        yield MarkerFrame(int(t_us), place, place, moved, seen, sure)


def _rate_hz(t_us: NDArray[np.int64]) -> float:
    import numpy as np

    return 1e6 / float(np.median(np.diff(t_us))) if len(t_us) > 1 else 1.0


PROGRESS_EVERY = 256
"""Frames between two reports of progress."""


def _scale_in_image(args: WatchArgs, tracks: Path) -> SkinScale | None:
    """Return the scale of a calibration, or else the one that tracks keep; None without either."""
    if args.calibration is not None:
        from spikingtac.calibration.sensor_calibration import Calibration

        return Calibration.load(args.calibration).skin_scale
    from spikingtac.tracks.tracks import Tracks

    try:
        found = Tracks.load(tracks)
    except RecordingError:  # arrays alone, of another program
        return None
    return found.skin_scale
