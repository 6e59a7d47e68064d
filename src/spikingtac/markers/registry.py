"""How markers are followed: settings, protocol, and the trackers and output laws by name."""

from __future__ import annotations  # the names of types stay short in the reference

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, get_args, runtime_checkable

from spikingtac import plugins
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.denoise.classical import DENOISERS, make_denoiser
from spikingtac.errors import named, require_type
from spikingtac.markers.graded.tracker import GradedTracker, GradedTrackerConfig
from spikingtac.markers.laws import AnchoredLaw, OutputLaw, PaperLaw, PaperLawConfig
from spikingtac.markers.paper import BlobTracker, BlobTrackerConfig
from spikingtac.types import EventPacket, LawName, MarkerFrame


@runtime_checkable
class MarkerTracker(Protocol):
    """Follows the markers of one sensor; free of input and output.

    It is split in two because the paper has two rates: perception sees every event, estimates are
    asked for at their own times.
    """

    def absorb(self, packet: EventPacket) -> None:
        """Take in every event of the next stretch of time (cost grows with the events).

        Any cutting of the same events into packets leads to the same state.
        """
        ...

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return the markers at ``t_us``, the end of what was absorbed."""
        ...

    def reset(self) -> None:
        """Forget everything but the calibration."""
        ...


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackingConfig:
    """How markers are followed; the registry says which methods there are.

    Attributes:
        method: ``disc`` or ``blobs``, or the name of another package's tracker.
        rate_hz: Estimates per second of data time.
        hysteresis: Law of the output position: ``none``, ``paper`` or ``anchored``.
        smooth: Whether tracks of files are smoothed backward, for ``disc``.
        denoiser: For ``blobs``: a name in :data:`spikingtac.denoise.classical.DENOISERS`.
        disc: For ``disc``.
        blobs: For ``blobs``.
        paper_law: For the law ``paper``.
        options: For a tracker from another package, which checks them itself.
    """

    method: str = "disc"
    rate_hz: float = field(default=1_000.0, metadata={"valid": (0.1, 1e6)})
    hysteresis: str = field(default="none", metadata={"choices": get_args(LawName)})
    smooth: bool = False
    denoiser: str = field(default="box7", metadata={"choices": tuple(DENOISERS)})
    disc: GradedTrackerConfig = field(default_factory=GradedTrackerConfig)
    blobs: BlobTrackerConfig = field(default_factory=BlobTrackerConfig)
    paper_law: PaperLawConfig = field(default_factory=PaperLawConfig)
    options: dict[str, Any] = field(default_factory=dict, hash=False)


Builder = Callable[[TrackingConfig, Calibration, OutputLaw], MarkerTracker]

# ``tracking.method`` -> builder, of this package.
TRACKERS: dict[str, Builder] = {
    "disc": lambda config, calibration, law: GradedTracker(config.disc, calibration, law),
    "blobs": lambda config, calibration, law: BlobTracker(
        config.blobs, calibration, make_denoiser(config.denoiser), law=law
    ),
}


def trackers() -> Mapping[str, Builder]:
    """Return every tracking method, also those that other packages register."""
    return plugins.WithPlugins(TRACKERS, plugins.TRACKERS)


def make_tracker(config: TrackingConfig, calibration: Calibration) -> MarkerTracker:
    """Build the tracker that a configuration names, for one sensor.

    Raises:
        ConfigError: The method, the denoiser or the law is unknown, or an argument is something
            else, as a name or a path.
        CalibrationError: A disc is too large to be followed.
    """
    require_type(config, TrackingConfig, "load_config('default').tracking")
    require_type(calibration, Calibration, "Calibration.load('calibration.json')")
    build = named(trackers(), config.method, "tracking method")
    return build(config, calibration, make_law(config))


def make_law(config: TrackingConfig) -> OutputLaw:
    """Build the output law that a configuration names."""
    laws: dict[str, Callable[[], OutputLaw]] = {
        "none": OutputLaw,
        "paper": lambda: PaperLaw(config.paper_law),
        "anchored": AnchoredLaw,
    }
    return named(laws, config.hysteresis, "hysteresis law")()
