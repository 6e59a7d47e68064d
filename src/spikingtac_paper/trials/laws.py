"""Comparison of output laws on the same stored estimates: none, published, anchored, re-zero.

A law computes output positions from detected ones, so no recording has to be tracked again. Every
law receives the same estimates, at the rate at which they are stored.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spikingtac.config import digest
from spikingtac.markers.anchored_law import AnchoredLaw, AnchoredLawConfig, ReZero, ReZeroConfig
from spikingtac.markers.hysteresis import NoLaw, OutputLaw, PaperLaw, PaperLawConfig
from spikingtac.schema import to_mapping
from spikingtac_paper.harness.fingerprint import code_digest
from spikingtac_paper.harness.rows import Row
from spikingtac_paper.trials.ground_truth import GroundTruth
from spikingtac_paper.trials.prediction import Prediction

LAW = "law"
"""Case of the rows without a recording: the effect of a law on exact detections."""

LAW_MARK = "-law-"
"""Part of the names of laws that use the estimates of a tracker."""

LOOP_PX, LOOP_STEP_PX = 10.0, 0.05
"""Radius and step of the loop of ``loop_drift_px``, px: out along x, a turn, back along y."""

LAW_METRICS = {
    "steepest_slope": "largest change of the output per change of the detection",
    "worst_falsification_px": "largest distance of the output from the detection, where bounded",
    "loop_drift_px": f"output after exact detections went {LOOP_PX:g} px along x, back along y",
}
"""Metric of the case :data:`LAW` -> its definition."""

GAMMAS, DELTAS_PX = (0.3, 0.5, 0.7, 1.0), (2.0, 4.0, 6.0)
"""Values of γ and δ in the sweep of the published law."""

ANCHORED_GAMMAS = (0.15, 0.3, 0.5, 0.7)
ANCHORED_DELTAS_PX = ((0.5, 1.5), (0.75, 2.0), (1.0, 3.0), (2.0, 4.0))
"""Values of γ and of (δ1, δ2) in the sweep of the anchored law."""


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
    return [
        _paper(f"{of}-law-paper", of, PaperLawConfig()),
        _anchored(f"{of}-law-anchored", of, AnchoredLawConfig()),
        LawMethod(
            name=f"{of}-law-rezero",
            about="anchored law around a zero that is learnt between contacts",
            of=of,
            law=ReZero,
            settings=to_mapping(ReZeroConfig()),
        ),
    ]


def neutac_binary() -> LawMethod:
    """Return NeuTac on the binary map; it equals ``paper`` without its law."""
    return LawMethod(
        name="neutac-binary",
        about="binary map, detection, no law: the estimates of paper before its law",
        of="paper",
        law=NoLaw,
        settings={},
    )


def swept_laws(of: str = "default") -> list[LawMethod]:
    """Return the sweep of the published law's γ and δ, and of the anchored law's."""
    published = [
        _paper(
            f"{of}-law-paper-{gamma:g}-{delta:g}", of, PaperLawConfig(gamma=gamma, delta_px=delta)
        )
        for gamma in GAMMAS
        for delta in DELTAS_PX
    ]
    anchored = [
        _anchored(
            f"{of}-law-anchored-{gamma:g}-{near:g}-{far:g}",
            of,
            AnchoredLawConfig(gamma=gamma, delta1_px=near, delta2_px=far),
        )
        for gamma in ANCHORED_GAMMAS
        for near, far in ANCHORED_DELTAS_PX
    ]
    return [*published, *anchored]


def law_rows(methods: Iterable[LawMethod]) -> Iterator[Row]:
    """Yield the effect of each law on exact detections: slope, falsification, drift on a loop."""
    for method in methods:
        law = method.law()
        slope, falsified_px = _bounds(law)
        yield _row(method.name, "steepest_slope", slope, "px/px")
        yield _row(method.name, "worst_falsification_px", falsified_px, "px")
        yield _row(method.name, "loop_drift_px", loop_drift_px(law), "px")


def loop_drift_px(law: OutputLaw) -> float:
    """Return the distance of a law's output from zero after a loop of exact detections, px."""
    out = np.arange(0.0, LOOP_PX, LOOP_STEP_PX)
    turn = np.arange(0.0, 0.5 * np.pi, LOOP_STEP_PX / LOOP_PX)
    none = np.zeros_like(out)
    x = np.concatenate([out, LOOP_PX * np.cos(turn), none, [0.0]])
    y = np.concatenate([none, LOOP_PX * np.sin(turn), out[::-1], [0.0]])
    rest = np.zeros((1, 2))
    law.reset()
    given = rest
    for point in zip(x.tolist(), y.tolist(), strict=True):
        given = law.update(np.array([point]), rest)
    return float(np.hypot(*given[0]))


def _bounds(law: OutputLaw) -> tuple[float, float | None]:
    if isinstance(law, AnchoredLaw):
        return law.config.steepest_slope, law.config.worst_falsification_px
    if isinstance(law, ReZero):
        config = law.config
        return config.map.steepest_slope, config.map.worst_falsification_px + config.reach_px
    return 1.0, 0.0 if isinstance(law, NoLaw) else None


def _paper(name: str, of: str, config: PaperLawConfig) -> LawMethod:
    about = f"published law, gamma {config.gamma:g}, delta {config.delta_px:g} px"
    return LawMethod(
        name=name, about=about, of=of, law=lambda: PaperLaw(config), settings=to_mapping(config)
    )


def _anchored(name: str, of: str, config: AnchoredLawConfig) -> LawMethod:
    span = f"{config.delta1_px:g} to {config.delta2_px:g} px"
    return LawMethod(
        name=name,
        about=f"anchored law, gamma {config.gamma:g}, {span}",
        of=of,
        law=lambda: AnchoredLaw(config),
        settings=to_mapping(config),
    )


def _row(method: str, metric: str, value: float | None, unit: str) -> Row:
    return Row(
        method=method,
        case=LAW,
        metric=metric,
        value=value,
        unit=unit,
        n=1,
        source="twin",
        paper=None,
        definition=LAW_METRICS[metric],
    )
