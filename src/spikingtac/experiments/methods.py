"""The methods that an experiment compares: name -> tracker, and all that it depends on."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

from spikingtac.baselines.ekalibr import EkalibrConfig, EkalibrTracker
from spikingtac.baselines.evetac import EvetacConfig, EvetacTracker
from spikingtac.baselines.neutac import NeutacConfig, NeutacTracker
from spikingtac.config import Config, digest, load_config
from spikingtac.experiments.fingerprint import code_digest
from spikingtac.markers.tracker import MarkerTracker
from spikingtac.registry import make_denoiser, make_tracker
from spikingtac.schema import to_mapping
from spikingtac.types import Calibration, EventPacket

Builder = Callable[[Calibration], MarkerTracker]
Before = Callable[[Iterable[EventPacket], Calibration], Iterable[EventPacket]]

OWN_CODE = ("markers", "state_map", "denoise", "events/filters.py", "events/filter_kernels.py")
"""Parts of the package that the project's own trackers are made of."""

EVETAC_HZ = 500.0
"""How often Evetac's dots are looked at; they move in slices of 1 ms whatever this is."""

TRUTH = "truth"
"""The method that knows the truth: its return distance is the gel's own residual."""


@dataclass(frozen=True, kw_only=True)
class Method:
    """A tracker as an experiment runs it.

    Attributes:
        name: Row of the report.
        about: One line.
        rate_hz: Estimates per second of data time.
        build: Makes the tracker for one calibration.
        settings: Everything that was chosen, for the digest and the report.
        code: Parts of the package behind it.
        before: Works on the events before the tracker sees them; None is nothing.
    """

    name: str
    about: str
    rate_hz: float
    build: Builder
    settings: Any
    code: tuple[str, ...] = OWN_CODE
    before: Before | None = field(default=None)

    def key(self) -> str:
        """Return the digest of configuration and code."""
        about = {"name": self.name, "rate_hz": self.rate_hz, "settings": self.settings}
        return digest({"method": about, "code": code_digest((*self.code, "pipeline.py"))})


def preset(name: str, preset_name: str | None = None, about: str = "") -> Method:
    """Return one of the project's own presets as a method."""
    config = load_config(preset_name or name)
    return of_config(name, about, config)


def of_config(name: str, about: str, config: Config) -> Method:
    """Return the tracker of a configuration as a method."""
    return Method(
        name=name,
        about=about,
        rate_hz=config.tracking.rate_hz,
        build=lambda calibration: make_tracker(config.tracking, calibration),
        settings=to_mapping(config.tracking),
    )


def _evetac(name: str, about: str, config: EvetacConfig) -> Method:
    return Method(
        name=name,
        about=about,
        rate_hz=EVETAC_HZ,
        build=lambda calibration: EvetacTracker(config, calibration),
        settings=to_mapping(config),
        code=("baselines/evetac.py", "baselines/attraction.py", "markers/neighbours.py"),
    )


def _neutac(name: str, about: str, config: NeutacConfig) -> Method:
    denoiser = load_config("paper").tracking.denoiser
    return Method(
        name=name,
        about=f"{about}, denoiser {denoiser}",
        rate_hz=config.rate_hz,
        build=lambda calibration: NeutacTracker(config, calibration, make_denoiser(denoiser)),
        settings={"denoiser": denoiser, **to_mapping(config)},
        code=("baselines/neutac.py", "baselines/time_surface.py", *OWN_CODE),
    )


def _ekalibr(name: str, about: str, config: EkalibrConfig) -> Method:
    return Method(
        name=name,
        about=about,
        rate_hz=config.rate_hz,
        build=lambda calibration: EkalibrTracker(config, calibration),
        settings=to_mapping(config),
        code=("baselines", "markers/associate.py"),
    )


def main_methods() -> dict[str, Method]:
    """Return the methods of the main table, in its order (``truth`` is added by the runner)."""
    methods = (
        preset("default", about="graded map, disc fit, no law"),
        preset("fast", about="graded map, centroids, 10 kHz"),
        preset("paper", about="binary map, blobs, k-d tree, hold, published law, 350 Hz"),
        _evetac("evetac", "attraction law, weak regulariser", EvetacConfig()),
        _evetac("evetac-strong", "attraction law, strong regulariser", EvetacConfig.strong()),
        _neutac("neutac", "time surface, detection, no law", NeutacConfig()),
        _neutac("neutac-binary", "binary map, detection, no law", NeutacConfig(surface="binary")),
        _ekalibr("ekalibr", "arcs paired, circle that moves in time", EkalibrConfig()),
    )
    return {method.name: method for method in methods}
