"""The tracking methods that an experiment compares, and output laws over their estimates."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spikingtac import Calibration, MarkerTracker, make_tracker, plugins
from spikingtac.config import Config, digest, load_config
from spikingtac.denoise import make_denoiser
from spikingtac.markers import (
    TRACKERS,
    AnchoredLaw,
    AnchoredLawConfig,
    NoLaw,
    OutputLaw,
    PaperLaw,
    PaperLawConfig,
    ReZero,
    ReZeroConfig,
    trackers,
)
from spikingtac.schema import to_mapping
from spikingtac.types import EventPacket
from spikingtac_paper.baselines.ekalibr import EkalibrConfig, EkalibrTracker
from spikingtac_paper.baselines.evetac import EvetacConfig, EvetacTracker
from spikingtac_paper.baselines.neutac import NeutacConfig, neutac_tracker
from spikingtac_paper.harness.run import code_digest
from spikingtac_paper.trials.ground_truth import GroundTruth
from spikingtac_paper.trials.prediction import Prediction

Builder = Callable[[Calibration], MarkerTracker]
Before = Callable[[Iterable[EventPacket], Calibration], Iterable[EventPacket]]

READ_BY_BASELINES = ("reference_px", "radius_px", "polarity", "size")
"""Calibration fields of trackers that use neither steps nor contrast nor lag."""

EVETAC_HZ = 500.0
"""Rate at which Evetac's dots are read out, Hz; they move in slices of 1 ms at any rate."""

TRUTH = "truth"
"""Name of the method that returns the truth; its return distance is the gel's own residual."""


@dataclass(frozen=True, kw_only=True)
class Method:
    """A tracking method of an experiment.

    Attributes:
        name: Name in the report.
        about: One line about it.
        rate_hz: Estimates per second of data time.
        build: Creates the tracker for a calibration.
        settings: All its settings, for the digest and the report.
        reads: Calibration fields that it reads; empty means all.
        before: Filter of the events before the tracker, or None.
    """

    name: str
    about: str
    rate_hz: float
    build: Builder
    settings: Any
    reads: tuple[str, ...] = ()
    before: Before | None = None

    def key(self) -> str:
        """Return the digest of configuration and code."""
        about = {"name": self.name, "rate_hz": self.rate_hz, "settings": self.settings}
        code = code_digest()
        return digest({"method": about, "code": code})


def of_preset(name: str, about: str) -> Method:
    """Return the tracker of a preset as a method."""
    return of_config(name, about, load_config(name))


def of_config(name: str, about: str, config: Config) -> Method:
    """Return the tracker of a configuration as a method."""
    return Method(
        name=name,
        about=about,
        rate_hz=config.tracking.rate_hz,
        build=lambda calibration: make_tracker(config.tracking, calibration),
        settings={"about": about, **to_mapping(config.tracking)},
        reads=READ_BY_BASELINES if config.tracking.method == "blobs" else (),
    )


def _evetac(name: str, about: str, config: EvetacConfig) -> Method:
    return Method(
        name=name,
        about=about,
        rate_hz=EVETAC_HZ,
        build=lambda calibration: EvetacTracker(config, calibration),
        settings=to_mapping(config),
        reads=READ_BY_BASELINES,
    )


def _neutac(name: str, about: str, config: NeutacConfig) -> Method:
    denoiser = load_config("paper").tracking.denoiser
    return Method(
        name=name,
        about=f"{about}, denoiser {denoiser}",
        rate_hz=config.rate_hz,
        build=lambda calibration: neutac_tracker(config, calibration, make_denoiser(denoiser)),
        settings={"denoiser": denoiser, **to_mapping(config)},
        reads=READ_BY_BASELINES,
    )


def _ekalibr(name: str, about: str, config: EkalibrConfig) -> Method:
    return Method(
        name=name,
        about=about,
        rate_hz=config.rate_hz,
        build=lambda calibration: EkalibrTracker(config, calibration),
        settings=to_mapping(config),
        reads=READ_BY_BASELINES,
    )


def main_methods() -> dict[str, Method]:
    """Return the methods of the main table in its order; the runner adds ``truth``."""
    methods = (
        of_preset("default", "graded map, disc fit, no law"),
        of_preset("fast", "the same tracker at 10 kHz"),
        of_preset("paper", "filter of isolated events and refreshed map (ours), binary map, "
                              "network, blobs, k-d tree, hold, published law, 350 Hz"),
        as_published("paper-printed", "the same without filter and refresh, as printed"),
        _evetac("evetac", "attraction law, weak regulariser", EvetacConfig()),
        _evetac("evetac-strong", "attraction law, strong regulariser", EvetacConfig.strong()),
        _neutac("neutac", "time surface, detection, no law", NeutacConfig()),
        _ekalibr("ekalibr", "arcs paired, circle that moves in time", EkalibrConfig()),
    )  # fmt: skip
    return {method.name: method for method in (*methods, *plugin_methods())}


def plugin_methods() -> list[Method]:
    """Return the trackers that other packages register, each with its default options."""
    return [
        of_config(name, f"of {plugins.origin(plugins.TRACKERS, name)}", _with_method(name))
        for name in trackers()
        if name not in TRACKERS
    ]


def _with_method(name: str) -> Config:
    return load_config("default").with_tracking(method=name)


def as_published(name: str, about: str) -> Method:
    """Return the preset ``paper`` without our additions: activity filter and map refresh."""
    config = load_config("paper")
    blobs = replace(config.tracking.blobs, support_us=0, refresh_us=0)
    return of_config(name, about, config.with_tracking(blobs=blobs))


@dataclass(frozen=True, kw_only=True)
class LawMethod:
    """An output law that uses the estimates of another method.

    Attributes:
        name: Name in the report.
        about: One line about it.
        of: Name of the method whose estimates it uses.
        law: Creates the law.
        settings: All its settings.
    """

    name: str
    about: str
    of: str
    law: Callable[[], OutputLaw]
    settings: Any

    def key(self) -> str:
        """Return the digest of configuration and code, without those of ``of``."""
        code = code_digest()
        return digest({"name": self.name, "of": self.of, "law": self.settings, "code": code})


def apply_law(prediction: Prediction, law: OutputLaw, truth: GroundTruth) -> Prediction:
    """Return a prediction with the output positions of a law.

    The re-zero law learns from the truth when nothing touches the skin: this is the best that a
    contact detector could achieve. It does not learn before the first release.
    """
    at_us = prediction.t_us[:, None]
    free = (at_us >= truth.free_us[:, 0]) & (at_us < truth.free_us[:, 1])
    touched = np.logical_not(np.any(free, axis=1))
    given = np.empty_like(prediction.detected_px)
    for number, (t_us, detected) in enumerate(
        zip(prediction.t_us.tolist(), prediction.detected_px.astype(np.float64), strict=True)
    ):
        if isinstance(law, ReZero):
            law.observe(t_us, bool(touched[number]))
        given[number] = law.update(detected, prediction.reference_px)
    return replace(prediction, position_px=given)


def compared_laws(of: str = "default") -> list[LawMethod]:
    """Return the laws of the main tables on the estimates of one method."""
    paper, anchored = PaperLawConfig(), AnchoredLawConfig()
    return [
        LawMethod(
            name=f"{of}-law-paper",
            about=f"published law, gamma {paper.gamma:g}, delta {paper.delta_px:g} px",
            of=of,
            law=PaperLaw,
            settings=to_mapping(paper),
        ),
        LawMethod(
            name=f"{of}-law-anchored",
            about=f"anchored law, gamma {anchored.gamma:g}, {anchored.delta1_px:g} to "
            f"{anchored.delta2_px:g} px",
            of=of,
            law=AnchoredLaw,
            settings=to_mapping(anchored),
        ),
        LawMethod(
            name=f"{of}-law-rezero",
            about="anchored law around a zero that is learnt between contacts",
            of=of,
            law=ReZero,
            settings=to_mapping(ReZeroConfig()),
        ),
    ]


def all_methods() -> dict[str, Method | LawMethod]:
    """Return the methods of the main tables, and the output laws that use their estimates."""
    methods: dict[str, Method | LawMethod] = {}
    for name, method in main_methods().items():
        methods[name] = method
        if name == "neutac":
            # NeuTac on the binary map equals ``paper`` without its law.
            about = "binary map, detection, no law: the estimates of paper before its law"
            binary = LawMethod(
                name="neutac-binary", about=about, of="paper", law=NoLaw, settings={}
            )
            methods[binary.name] = binary
    return methods | {method.name: method for method in compared_laws()}
