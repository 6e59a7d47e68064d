"""Names of exchangeable parts: name -> how to build it. Plain dictionaries, nothing hidden."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from spikingtac.config import TrackingConfig
from spikingtac.denoise.classical import CLASSICAL_DENOISERS
from spikingtac.denoise.denoiser import Denoiser
from spikingtac.errors import ConfigError, nearest
from spikingtac.markers.anchored_law import AnchoredLaw
from spikingtac.markers.blob_tracker import BlobTracker
from spikingtac.markers.centroid_locator import CentroidLocator
from spikingtac.markers.disc_locator import DiscLocator
from spikingtac.markers.graded_tracker import GradedTracker
from spikingtac.markers.hysteresis import NoLaw, OutputLaw, PaperLaw
from spikingtac.markers.tracker import MarkerTracker
from spikingtac.types import Calibration

T = TypeVar("T")

Builder = Callable[[TrackingConfig, Calibration, OutputLaw], MarkerTracker]


def _disc(config: TrackingConfig, calibration: Calibration, law: OutputLaw) -> MarkerTracker:
    return GradedTracker(DiscLocator(config.disc, calibration), config.care, calibration, law)


def _centroid(config: TrackingConfig, calibration: Calibration, law: OutputLaw) -> MarkerTracker:
    locator = CentroidLocator(config.centroid, calibration)
    return GradedTracker(locator, config.care, calibration, law)


def _blobs(config: TrackingConfig, calibration: Calibration, law: OutputLaw) -> MarkerTracker:
    return BlobTracker(config.blobs, calibration, make_denoiser(config.denoiser), law=law)


TRACKERS: dict[str, Builder] = {"disc": _disc, "centroid": _centroid, "blobs": _blobs}
"""``tracking.method`` -> builder."""


def _network(name: str) -> Callable[[], Denoiser]:
    def build() -> Denoiser:
        from spikingtac.denoise.infer import shipped_denoiser  # with ONNX Runtime behind it

        return shipped_denoiser(name)

    return build


DENOISERS: dict[str, Callable[[], Denoiser]] = {
    **CLASSICAL_DENOISERS,
    **{name: _network(name) for name in ("network", "network-int8", "supervised")},
}
"""``tracking.denoiser`` -> builder. ``supervised`` has seen the simulator's noise-free maps:
an upper bound for experiments, used by no preset."""


def make_tracker(config: TrackingConfig, calibration: Calibration) -> MarkerTracker:
    """Build the tracker that a configuration names, for one sensor.

    Raises:
        ConfigError: The method, the denoiser or the law is unknown.
    """
    build = _named(TRACKERS, config.method, "tracking method")
    return build(config, calibration, make_law(config))


def make_law(config: TrackingConfig) -> OutputLaw:
    """Build the output law that a configuration names."""
    laws: dict[str, Callable[[], OutputLaw]] = {
        "none": NoLaw,
        "paper": lambda: PaperLaw(config.paper_law),
        "anchored": lambda: AnchoredLaw(config.anchored_law),
    }
    return _named(laws, config.hysteresis, "hysteresis law")()


def make_denoiser(name: str) -> Denoiser:
    """Build the denoiser of a name."""
    return _named(DENOISERS, name, "denoiser")()


def _named(table: dict[str, T], name: str, kind: str) -> T:
    if name not in table:
        raise ConfigError(
            f"unknown {kind} {name!r}{nearest(name, table)} (valid: {', '.join(table)})"
        )
    return table[name]
