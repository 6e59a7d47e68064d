"""The contact detectors by name, each built from quiet windows of the moving arm."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from spikingtac import plugins
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.contact.detector import ContactDetector, QuietStatistics, Window, check_budget
from spikingtac.contact.event_count import EventCountConfig, EventCountDetector
from spikingtac.contact.sequential_detector import SequentialMotionDetector
from spikingtac.errors import named
from spikingtac.plugins import with_plugins


@dataclass(frozen=True, kw_only=True)
class DetectionConfig:
    """How contacts are detected.

    Attributes:
        detector: Name of the detector; None is ``default`` where the sensors are calibrated and
            ``event_count`` otherwise.
        false_alarms_per_hour: Budget of false contacts while the arm moves freely.
        release_windows: For ``event_count``: a contact ends after this many quiet windows in a row.
    """

    detector: str | None = None
    false_alarms_per_hour: float = 1.0
    release_windows: int = 50

    def __post_init__(self) -> None:
        check_budget(self.false_alarms_per_hour)


# Builds a detector from settings, the sensors' calibrations, and quiet windows.
DetectorBuilder = Callable[
    [DetectionConfig, Sequence[Calibration], Iterable[Window]], ContactDetector
]


def _event_count(
    config: DetectionConfig, calibrations: Sequence[Calibration], quiet: Iterable[Window]
) -> ContactDetector:
    statistics = QuietStatistics.of(quiet)
    threshold = statistics.threshold(config.false_alarms_per_hour)
    return EventCountDetector(
        EventCountConfig(threshold=threshold, release_windows=config.release_windows), statistics
    )


def _motion(
    config: DetectionConfig, calibrations: Sequence[Calibration], quiet: Iterable[Window]
) -> ContactDetector:
    return SequentialMotionDetector.from_quiet(calibrations, quiet, config.false_alarms_per_hour)


# Name -> builder of the detectors of this package, as reports name them.
DETECTORS: dict[str, DetectorBuilder] = {"event_count": _event_count, "default": _motion}
ALIASES = {"motion": "default"}  # Further name -> name in :data:`DETECTORS`.


def detectors() -> Mapping[str, DetectorBuilder]:
    """Return every detector by name, also those that other packages register."""
    own = {**DETECTORS, **{alias: DETECTORS[name] for alias, name in ALIASES.items()}}
    return with_plugins(own, plugins.DETECTORS)


def make_detector(
    name: str,
    config: DetectionConfig,
    calibrations: Sequence[Calibration],
    quiet: Iterable[Window],
) -> ContactDetector:
    """Build a detector by name.

    Args:
        name: ``event_count`` (as published), ``default`` (also called ``motion``), or the name
            of an entry point of the group ``spikingtac.contact_detectors``.
        config: Budget and settings.
        calibrations: Of each sensor, in the windows' order, with the probe in the grip.
        quiet: Windows of the moving arm without contact, in order; see each detector for how many.

    Raises:
        ConfigError: The name is unknown, or the detector's package cannot be loaded.
        CalibrationError: The quiet windows are too few, or a calibration is missing.
    """
    return named(detectors(), name, "contact detector")(config, calibrations, quiet)
