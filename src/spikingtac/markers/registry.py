"""The trackers and the output laws by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from spikingtac import plugins
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.denoise.registry import make_denoiser
from spikingtac.errors import named, require_type
from spikingtac.markers.anchored_law import AnchoredLaw
from spikingtac.markers.graded.appearance import has_rare_off
from spikingtac.markers.graded.tracker import GradedTracker
from spikingtac.markers.hysteresis import NoLaw, OutputLaw, PaperLaw
from spikingtac.markers.paper import BlobTracker
from spikingtac.markers.tracker import MarkerTracker
from spikingtac.markers.tracking_config import TrackingConfig
from spikingtac.plugins import with_plugins

Builder = Callable[[TrackingConfig, Calibration, OutputLaw], MarkerTracker]


def _disc(config: TrackingConfig, calibration: Calibration, law: OutputLaw) -> MarkerTracker:
    return GradedTracker(config.disc, calibration, law)


def _bands(config: TrackingConfig, calibration: Calibration, law: OutputLaw) -> MarkerTracker:
    return GradedTracker(config.disc, calibration, law, fit="bands")


def _blobs(config: TrackingConfig, calibration: Calibration, law: OutputLaw) -> MarkerTracker:
    return BlobTracker(config.blobs, calibration, make_denoiser(config.denoiser), law=law)


# ``tracking.method`` -> builder, of this package.
TRACKERS: dict[str, Builder] = {
    "disc": _disc,
    "bands": _bands,
    "blobs": _blobs,
}


def trackers() -> Mapping[str, Builder]:
    """Return every tracking method, also those that other packages register."""
    return with_plugins(TRACKERS, plugins.TRACKERS)


def make_tracker(config: TrackingConfig, calibration: Calibration) -> MarkerTracker:
    """Build the tracker that a configuration names, for one sensor.

    Raises:
        ConfigError: The method, the denoiser or the law is unknown, or an argument is something
            else, as a name or a path.
    """
    require_type(config, TrackingConfig, "load_config('default').tracking")
    require_type(calibration, Calibration, "Calibration.load('calibration.json')")
    rare = config.rare_off_method and has_rare_off(calibration)
    method = config.rare_off_method if rare else config.method
    build = named(trackers(), method, "tracking method")
    return build(config, calibration, make_law(config))


def make_law(config: TrackingConfig) -> OutputLaw:
    """Build the output law that a configuration names."""
    laws: dict[str, Callable[[], OutputLaw]] = {
        "none": NoLaw,
        "paper": lambda: PaperLaw(config.paper_law),
        "anchored": lambda: AnchoredLaw(config.anchored_law),
    }
    return named(laws, config.hysteresis, "hysteresis law")()
