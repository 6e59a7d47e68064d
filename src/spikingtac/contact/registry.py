"""The contact detectors by name, each built from quiet windows of the moving arm."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.contact.detector import ContactDetector, Window
from spikingtac.contact.event_count import EventCountConfig, EventCountDetector
from spikingtac.contact.motion_detector import MotionConfig, MotionDetector
from spikingtac.contact.quiet import QuietStatistics
from spikingtac.errors import ConfigError, nearest


@dataclass(frozen=True, kw_only=True)
class DetectionConfig:
    """What is asked of a contact detector.

    Attributes:
        false_alarms_per_hour: Budget of false contacts while the arm moves freely.
        release_windows: Of ``event_count``: quiet windows in a row after which a contact ended.
        motion: Of ``default``.
    """

    false_alarms_per_hour: float = 1.0
    release_windows: int = 50
    motion: MotionConfig = field(default_factory=MotionConfig)


DetectorBuilder = Callable[
    [DetectionConfig, Sequence[Calibration], Iterable[Window]], ContactDetector
]


def _event_count(
    config: DetectionConfig, calibrations: Sequence[Calibration], quiet: Iterable[Window]
) -> ContactDetector:
    statistics = QuietStatistics.of(quiet)
    threshold = statistics.threshold(config.false_alarms_per_hour)
    return EventCountDetector(
        EventCountConfig(threshold=threshold, release_windows=config.release_windows)
    )


def _motion(
    config: DetectionConfig, calibrations: Sequence[Calibration], quiet: Iterable[Window]
) -> ContactDetector:
    budget = config.false_alarms_per_hour
    return MotionDetector.from_quiet(config.motion, calibrations, quiet, budget)


DETECTORS: dict[str, DetectorBuilder] = {"event_count": _event_count, "default": _motion}
"""Name -> builder."""


def make_detector(
    name: str,
    config: DetectionConfig,
    calibrations: Sequence[Calibration],
    quiet: Iterable[Window],
) -> ContactDetector:
    """Build a detector by name.

    Args:
        name: ``event_count`` (as published) or ``default``.
        config: Budget and release.
        calibrations: Of each sensor, in the windows' order, with the probe in the grip.
        quiet: Windows of the moving arm without contact, in order; see each detector for how many.

    Raises:
        ConfigError: The name is unknown.
        CalibrationError: The quiet windows are too few.
    """
    if name not in DETECTORS:
        raise ConfigError(
            f"no contact detector {name!r}{nearest(name, DETECTORS)} "
            f"(valid: {', '.join(DETECTORS)})"
        )
    return DETECTORS[name](config, calibrations, quiet)
