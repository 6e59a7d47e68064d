"""Scenes of the twin as a sensor feels them: tracked by ``default`` from their events."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from spikingtac import Calibration, follow, make_tracker
from spikingtac.config import load_config
from spikingtac.sim import SceneSource
from spikingtac.types import EventPacket, MarkerFrame

RATE_HZ = 1_000.0  # Estimates per second.


def watch(
    source: SceneSource, note: Callable[[Any], None], rate_hz: float = RATE_HZ
) -> Iterator[MarkerFrame]:
    """Yield the markers that the tracker finds, with a calibration without error.

    Args:
        source: A fresh source of the scene.
        note: Is called with each :class:`~spikingtac.sim.SceneStep` before it is tracked.
        rate_hz: Estimates per second.
    """

    def packets() -> Iterator[EventPacket]:
        for step in source.steps():
            note(step)
            yield step.packet

    calibration = Calibration(
        reference_px=source.reference_px,
        radius_px=source.radius_px,
        grid=source.scene.skin.grid,
        size=source.size,
        polarity="white",
    )
    return follow(packets(), make_tracker(load_config("default").tracking, calibration), rate_hz)


def record(
    method: str, cases: Sequence[str], seed: int, scores: dict[str, float], source: str = "twin"
) -> dict[str, Any]:
    """Return scores as :func:`~spikingtac_paper.harness.report.rows_of` reads them.

    Args:
        method: Name of the method.
        cases: The case, then those that it is a part of.
        seed: Seed of the scene.
        scores: Metric -> value.
        source: ``twin`` or ``recorded``.
    """
    trial = {"case": cases[0], "groups": list(cases[1:]), "seed": seed, "source": source}
    return {"method": method, "trial": trial, "scores": scores}
