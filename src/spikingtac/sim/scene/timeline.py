"""Which body is where at which time of a scene: the contacts of one seed, in order."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim.gel.indenters import Indenter, make_indenter
from spikingtac.sim.scene.motions import Motion, minimum_jerk
from spikingtac.sim.scene.scene import ContactConfig, HistoryConfig, Scene
from spikingtac.sim.scene.variation import vary
from spikingtac.types import Pose

_MOTION_STREAM, _HISTORY_STREAM = 1, 2
"""Independent streams of random numbers under one seed."""


@dataclass(frozen=True, slots=True)
class Visit:
    """One contact as it takes place: from ``start_s`` to ``end_s`` of the scene's time."""

    start_s: float
    end_s: float
    indenter: Indenter
    motion: Motion


class Timeline:
    """The contacts of a scene for one seed; asked for times that never decrease.

    Args:
        scene: The scene.
        seed: Of the variations.
        duration_s: None is the scene's own length; a shorter one cuts it, a longer one repeats
            the contacts (varied anew) as often as they fit; infinity never ends.
    """

    def __init__(self, scene: Scene, seed: int, duration_s: float | None = None) -> None:
        self._rng = np.random.default_rng([seed, _MOTION_STREAM])
        self._round = list(_visits(scene, scene.lead_in_s, self._rng))
        own = _own_length_s(scene, self._round)
        self.duration_s = own if duration_s is None else duration_s
        self._visits = itertools.chain(self._round, self._more(scene))
        self._current = next(self._visits, None)

    def at(self, t_s: float) -> tuple[Indenter, Pose] | None:
        """Return the body and its pose, or None where none is near."""
        visit = self._visit_at(t_s)
        return None if visit is None else (visit.indenter, visit.motion.pose(t_s - visit.start_s))

    def moved_mm(self, start_s: float, end_s: float) -> float:
        """Return how far the body that is near at ``start_s`` moves until ``end_s``, mm."""
        visit = self._visit_at(start_s)
        if visit is None:
            return 0.0
        start, end = (visit.motion.pose(t_s - visit.start_s) for t_s in (start_s, end_s))
        return float(np.linalg.norm(end.position_mm - start.position_mm))

    def _visit_at(self, t_s: float) -> Visit | None:
        while self._current is not None and t_s >= self._current.end_s:
            self._current = next(self._visits, None)
        if self._current is None or t_s < self._current.start_s:
            return None
        return self._current

    def _more(self, scene: Scene) -> Iterator[Visit]:
        last_end_s = self.duration_s - scene.lead_out_s
        while self._round:
            start_s = self._round[-1].end_s + scene.lead_in_s
            self._round = list(_visits(scene, start_s, self._rng))
            for visit in self._round:
                if visit.end_s > last_end_s:
                    return
                yield visit


def earlier_drag_mm(
    config: HistoryConfig, seed: int, times_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return how far the skin was dragged, ``(n, 2)`` mm, at times since the history began."""
    heading = math.tau * np.random.default_rng([seed, _HISTORY_STREAM]).random()
    away = config.slide_mm * np.array([math.cos(heading), math.sin(heading)])
    strokes = np.clip(2.0 * times_s / config.duration_s, 0.0, 2.0)
    covered = np.array([minimum_jerk(1.0 - abs(1.0 - float(stroke))) for stroke in strokes])
    return covered[:, None] * away


def _visits(scene: Scene, start_s: float, rng: np.random.Generator) -> Iterator[Visit]:
    for contact in scene.contacts:
        indenter = make_indenter(contact.indenter)
        for _ in range(contact.repeats):
            visit = _visit(scene, contact, indenter, start_s, rng)
            start_s = visit.end_s + contact.pause_s
            yield visit


def _visit(
    scene: Scene,
    contact: ContactConfig,
    indenter: Indenter,
    start_s: float,
    rng: np.random.Generator,
) -> Visit:
    start_s += scene.variation.pause_s * rng.random()
    motion = Motion(vary(contact.motion, scene.variation, rng))
    return Visit(start_s, start_s + motion.duration_s, indenter, motion)


def _own_length_s(scene: Scene, visits: list[Visit]) -> float:
    return visits[-1].end_s + scene.lead_out_s if visits else scene.duration_s
