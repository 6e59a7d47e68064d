"""The tracking methods that an experiment compares, and output laws over their estimates."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from spikingtac import Calibration, MarkerTracker, follow, make_tracker, plugins
from spikingtac.config import Config, load_config
from spikingtac.markers import (
    TRACKERS,
    AnchoredLaw,
    OutputLaw,
    PaperLaw,
    PaperLawConfig,
    trackers,
)
from spikingtac.types import EventPacket
from spikingtac_paper.baselines.ekalibr import RATE_HZ as EKALIBR_HZ
from spikingtac_paper.baselines.ekalibr import EkalibrTracker
from spikingtac_paper.baselines.evetac import RATE_HZ as EVETAC_HZ
from spikingtac_paper.baselines.evetac import STRONG, EvetacTracker
from spikingtac_paper.baselines.neutac import RATE_HZ as NEUTAC_HZ
from spikingtac_paper.baselines.neutac import neutac_tracker
from spikingtac_paper.trials.trajectories import Prediction

# Name of the method that returns the truth; its return distance is the gel's own residual.
TRUTH = "truth"


@dataclass(frozen=True, kw_only=True)
class Method:
    """A tracking method of an experiment, or an output law over the estimates of one.

    Attributes:
        name: Name in the report.
        about: One line about it.
        tracker: Name of the method whose estimates it uses: its own without a law.
        rate_hz: Estimates per second of data time.
        build: Creates the tracker for a calibration.
        before: Filter of the events before the tracker, or None.
        law: Creates the output law that takes the place of the tracker's own, or None.
    """

    name: str
    about: str
    tracker: str
    rate_hz: float
    build: Callable[[Calibration], MarkerTracker]
    before: Callable[[Iterable[EventPacket], Calibration], Iterable[EventPacket]] | None = None
    law: Callable[[], OutputLaw] | None = None

    def track(
        self, events: Iterable[EventPacket], calibration: Calibration, kept_hz: float
    ) -> Prediction:
        """Return the estimates of the tracker on a recording, at ``kept_hz`` at most."""
        if self.before is not None:
            events = self.before(events, calibration)
        frames = follow(events, self.build(calibration), self.rate_hz)
        every = max(1, round(self.rate_hz / kept_hz))
        return Prediction.collect(frames, calibration.reference_px, every)

    def with_law(self, suffix: str, about: str, law: Callable[[], OutputLaw]) -> Method:
        """Return the method that lays a law over the estimates of this one."""
        return replace(self, name=f"{self.name}-{suffix}", about=about, law=law)


def of_config(name: str, about: str, config: Config | None = None) -> Method:
    """Return the tracker of a configuration, or of the preset of that name, as a method."""
    tracking = (config or load_config(name)).tracking
    return Method(
        name=name,
        about=about,
        tracker=name,
        rate_hz=tracking.rate_hz,
        build=lambda calibration: make_tracker(tracking, calibration),
    )


# Trackers of other groups: name -> what it is, how it is made for a calibration, its rate, Hz.
BASELINES: dict[str, tuple[str, Callable[[Calibration], MarkerTracker], float]] = {
    "evetac": ("attraction law, weak regulariser", EvetacTracker, EVETAC_HZ),
    "evetac-strong": ("attraction law, strong regulariser",
                      functools.partial(EvetacTracker, **STRONG), EVETAC_HZ),
    "neutac": ("time surface, denoiser of paper, detection, no law", neutac_tracker, NEUTAC_HZ),
    "ekalibr": ("arcs paired, circle that moves in time", EkalibrTracker, EKALIBR_HZ),
}  # fmt: skip


def main_methods() -> dict[str, Method]:
    """Return the methods of the main table in its order; the runner adds ``truth``."""
    default = load_config("default")
    # Trackers that other packages register run with their default options.
    others = [name for name in trackers() if name not in TRACKERS]
    methods = (
        of_config("default", "graded map, disc fit, no law"),
        of_config("fast", "the same tracker at 10 kHz"),
        of_config("paper", "filter of isolated events and refreshed map, binary map, "
                           "network, blobs, k-d tree, hold, published law, 350 Hz"),
        as_published("paper-printed", "the same without filter and refresh, as printed"),
        *(Method(name=name, about=about, tracker=name, rate_hz=rate_hz, build=build)
          for name, (about, build, rate_hz) in BASELINES.items()),
        *(of_config(name, f"of {plugins.origin(plugins.TRACKERS, name)}",
                    default.with_tracking(method=name)) for name in others),
    )  # fmt: skip
    return {method.name: method for method in methods}


def as_published(name: str, about: str) -> Method:
    """Return the preset ``paper`` without our additions: activity filter and map refresh."""
    config = load_config("paper")
    blobs = replace(config.tracking.blobs, support_us=0, refresh_us=0)
    return of_config(name, about, config.with_tracking(blobs=blobs))


def apply_law(prediction: Prediction, law: OutputLaw) -> Prediction:
    """Return a prediction with the output positions of a law."""
    given = np.empty_like(prediction.detected_px)
    for number, detected in enumerate(prediction.detected_px.astype(np.float64)):
        given[number] = law.update(detected, prediction.reference_px)
    return replace(prediction, position_px=given)


def compared_laws() -> list[Method]:
    """Return the laws of the main tables on the estimates of ``default``."""
    default = main_methods()["default"]
    paper = PaperLawConfig()
    about = f"published law, gamma {paper.gamma:g}, delta {paper.delta_px:g} px"
    return [
        default.with_law("law-paper", about, PaperLaw),
        default.with_law("law-anchored", "anchored law, gamma 0.3, 0.75 to 2 px", AnchoredLaw),
    ]


def all_methods() -> dict[str, Method]:
    """Return the methods of the main tables, and the output laws that use their estimates."""
    methods = main_methods()
    # NeuTac on the binary map equals ``paper`` without its law.
    about = "binary map, detection, no law: the estimates of paper before its law"
    binary = replace(methods["paper"], name="neutac-binary", about=about, law=OutputLaw)
    return methods | {method.name: method for method in (binary, *compared_laws())}
