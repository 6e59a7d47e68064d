"""The contacts of a scene for one seed: their variation, and which body is where at a time."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from spikingtac.sim.indenters import Indenter, make_indenter
from spikingtac.sim.motions import IndenterMotion, MotionConfig, SegmentConfig, minimum_jerk
from spikingtac.sim.scene import HistoryConfig, Scene, VariationConfig
from spikingtac.types import FloatArray, Pose

FULL_TURN_DEG = 360.0
QUIET_S = 3.0  # Length of a scene without contacts, s.


def vary(
    motion: MotionConfig, variation: VariationConfig, rng: np.random.Generator
) -> MotionConfig:
    """Return a motion with the variation of one contact of one seed.

    Args:
        motion: Motion of the scene file.
        variation: Limits of the variation.
        rng: Source of the draws; seven are taken in every case.
    """
    draw = rng.uniform(-1.0, 1.0, 7)
    heading_deg = float(variation.heading_deg * draw[2])
    depth = 1.0 + float(variation.depth_fraction * draw[4])
    extent = 1.0 + float(variation.extent_fraction * draw[5])
    speed = 1.0 + float(variation.speed_fraction * draw[6])
    factors = {
        **{"depth_mm": depth, "dx_mm": extent, "dy_mm": extent, "angle_deg": extent},
        **{"duration_s": 1.0 / speed, "speed_mm_s": speed, "speed_deg_s": speed},
    }
    return replace(
        motion,
        x_mm=motion.x_mm + float(variation.place_mm * draw[0]),
        y_mm=motion.y_mm + float(variation.place_mm * draw[1]),
        yaw_deg=motion.yaw_deg + float(variation.yaw_deg * draw[3]),
        segments=tuple(_varied(segment, factors, heading_deg) for segment in motion.segments),
    )


def _varied(segment: SegmentConfig, factors: dict[str, float], heading_deg: float) -> SegmentConfig:
    """Return a segment whose lengths and times are scaled, and whose way is turned."""
    if segment.kind == "circle":  # a roll's radius is its body's, not its path's
        factors = factors | {"radius_mm": factors["dx_mm"]}
    values = {name: getattr(segment, name) for name in factors}
    changed = {name: value * factors[name] for name, value in values.items() if value is not None}
    if heading_deg != 0.0 and segment.kind == "circle":
        changed["heading_deg"] = ((segment.heading_deg or 0.0) + heading_deg) % FULL_TURN_DEG
    elif heading_deg != 0.0 and ("dx_mm" in changed or "dy_mm" in changed):
        dx, dy = changed.get("dx_mm", 0.0), changed.get("dy_mm", 0.0)
        cosine, sine = math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))
        changed |= {"dx_mm": cosine * dx - sine * dy, "dy_mm": sine * dx + cosine * dy}
    return replace(segment, **changed)


_MOTION_STREAM, _HISTORY_STREAM = 1, 2  # Numbers of independent random streams of one seed.


DRAG_S = 0.3  # Duration of the drag before a recording and its release, s.


class TimedContact(NamedTuple):
    """One contact with its variations, and its time in the scene.

    Attributes:
        start_s: Start, s.
        end_s: End, s.
        indenter: The body.
        motion: Its motion from ``start_s`` on.
    """

    start_s: float
    end_s: float
    indenter: Indenter
    motion: IndenterMotion


class Timeline:
    """The contacts of a scene for one seed. Times must be requested in increasing order.

    Args:
        scene: The scene.
        seed: Seed of the variations.
        duration_s: Length, s. None is the scene's own length; a shorter one cuts it; a longer one
            repeats the contacts, varied anew, as often as they fit; infinity never ends.

    Attributes:
        duration_s: Length, s.
    """

    def __init__(self, scene: Scene, seed: int, duration_s: float | None = None) -> None:
        self._rng = np.random.default_rng([seed, _MOTION_STREAM])
        self._sequence = list(_contacts(scene, scene.lead_in_s, self._rng))
        ends_s = [contact.end_s + scene.lead_out_s for contact in self._sequence]
        self.duration_s = [QUIET_S, *ends_s][-1] if duration_s is None else duration_s
        self._contacts = itertools.chain(self._sequence, self._repeats(scene))
        self._current = next(self._contacts, None)

    def at(self, t_s: float) -> tuple[Indenter, Pose] | None:
        """Return the body and its pose at ``t_s`` (s), or None if there is none."""
        if (contact := self._contact_at(t_s)) is None:
            return None
        return contact.indenter, contact.motion.pose(t_s - contact.start_s)

    def moved_mm(self, start_s: float, end_s: float) -> float:
        """Return how far the body at ``start_s`` moves until ``end_s``, mm."""
        if (contact := self._contact_at(start_s)) is None:
            return 0.0
        start, end = (contact.motion.pose(t_s - contact.start_s) for t_s in (start_s, end_s))
        return float(np.linalg.norm(end.position_mm - start.position_mm))

    def _contact_at(self, t_s: float) -> TimedContact | None:
        while self._current is not None and t_s >= self._current.end_s:
            self._current = next(self._contacts, None)
        if self._current is None or t_s < self._current.start_s:
            return None
        return self._current

    def _repeats(self, scene: Scene) -> Iterator[TimedContact]:
        last_end_s = self.duration_s - scene.lead_out_s
        while self._sequence:
            start_s = self._sequence[-1].end_s + scene.lead_in_s
            self._sequence = list(_contacts(scene, start_s, self._rng))
            for contact in self._sequence:
                if contact.end_s > last_end_s:
                    return
                yield contact


def prior_drag_mm(config: HistoryConfig, seed: int, times_s: FloatArray) -> FloatArray:
    """Return the displacement ``(n, 2)`` of the skin by the drag before the recording, mm.

    Args:
        config: The history.
        seed: Seed of the direction.
        times_s: ``(n,)`` times since the start of the history, s.
    """
    heading = math.tau * np.random.default_rng([seed, _HISTORY_STREAM]).random()
    away = config.slide_mm * np.array([math.cos(heading), math.sin(heading)])
    strokes = np.clip(2.0 * times_s / DRAG_S, 0.0, 2.0)
    covered = np.array([minimum_jerk(1.0 - abs(1.0 - float(stroke))) for stroke in strokes])
    return covered[:, None] * away


def _contacts(scene: Scene, start_s: float, rng: np.random.Generator) -> Iterator[TimedContact]:
    for contact in scene.contacts:
        indenter = make_indenter(contact.indenter)
        for _ in range(contact.repeats):
            start_s += scene.variation.pause_s * rng.random()
            motion = IndenterMotion(vary(contact.motion, scene.variation, rng))
            end_s = start_s + motion.duration_s
            yield TimedContact(start_s, end_s, indenter, motion)
            start_s = end_s + contact.pause_s
