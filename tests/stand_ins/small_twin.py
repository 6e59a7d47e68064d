"""A small simulated sensor, its slides for a calibration, and touches whose truth is known.

Rendered once per run with fixed seeds: sixteen markers on 176 x 176 px, a camera of the preset
``typical``, four seconds of slides and two and a half of touches.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from spikingtac import Calibration, EventPacket, SceneSource, calibrate
from spikingtac.events.source import PacketSource
from spikingtac.schema import build
from spikingtac.sim.scene import Scene
from spikingtac.sim.source import TruthChunk
from spikingtac_paper.trials.trajectories import places_at
from stand_ins.made_once import made_once

SLIDES_SEED, TOUCHES_SEED = 1, 1
LAST_LEAD_S = 0.25
SENSOR: dict[str, Any] = {
    "skin": {"grid": [4, 4]},
    "optics": {"size": [176, 176]},
    "gel": {"grid": {"cells": 24, "span_mm": 28.0}},
}

# Nine of its markers.
SMALLEST = SENSOR | {"skin": {"grid": [3, 3]}, "optics": {"size": [140, 140]}}
PLATE = {"kind": "punch", "settings": {"radius_mm": 12.5}}  # It carries all markers alike.

OUT_MM = 1.0  # Some 16 px, almost half of the markers' pitch.

# Slow and fast slides up to 500 px/s, a sudden release, then a finger that presses and twists.
TOUCHES = SENSOR | {
    "lead_in_s": 0.35,
    "lead_out_s": LAST_LEAD_S,
    "contacts": [
        {
            "indenter": PLATE,
            "pause_s": 0.05,
            "motion": {
                "height_mm": 0.1,
                "segments": [
                    {"kind": "press", "depth_mm": 0.15, "duration_s": 0.1},
                    {"kind": "slide", "dx_mm": OUT_MM, "dy_mm": 0.2, "duration_s": 0.25},
                    {"kind": "hold", "duration_s": 0.25},
                    {"kind": "slide", "dx_mm": -OUT_MM, "dy_mm": -0.2, "duration_s": 0.25},
                    {"kind": "slide", "dx_mm": -0.6, "dy_mm": 0.7, "duration_s": 0.1},
                    {"kind": "slide", "dx_mm": 0.9, "dy_mm": -0.9, "duration_s": 0.08},
                    {"kind": "slide", "dx_mm": 0.3, "dy_mm": 0.7, "duration_s": 0.2},
                    {"kind": "release", "height_mm": 0.2},
                ],
            },
        },
        {
            "indenter": {"kind": "finger"},
            "motion": {
                "x_mm": -0.5,
                "height_mm": 0.2,
                "segments": [
                    {"kind": "press", "depth_mm": 1.6, "duration_s": 0.15},
                    {"kind": "twist", "angle_deg": 35.0, "duration_s": 0.2},
                    {"kind": "slide", "dx_mm": 0.8, "duration_s": 0.12},
                    {"kind": "lift", "height_mm": 0.2, "duration_s": 0.12},
                ],
            },
        },
    ],
}

# When the first slide begins, and ends; when the way back begins, and ends.
FIRST_SLIDE_US, HOLD_US, RETURN_US, HOME_US = 450_000, 700_000, 950_000, 1_200_000


@dataclass(frozen=True)
class Film:
    """Events and the truth behind them.

    Attributes:
        packets: The events, in order.
        size: ``(width, height)``, px.
        reference_px: ``(m, 2)`` markers at rest, px.
        radius_px: ``(m,)`` their radii, px.
        truth: Where the markers were, and when anything touched the skin.
    """

    packets: tuple[EventPacket, ...]
    size: tuple[int, int]
    reference_px: np.ndarray
    radius_px: np.ndarray
    truth: TruthChunk

    def at(self, t_us: np.ndarray) -> np.ndarray:
        """Return ``(n, m, 2)`` true positions, px."""
        return places_at(t_us, self.truth.marker_t_us, self.truth.marker_px.astype(np.float64))

    def velocity_px_s(self, t_us: np.ndarray) -> np.ndarray:
        """Return ``(n, m, 2)`` true velocities, px/s."""
        return 1e3 * (self.at(t_us + 500) - self.at(t_us - 500))

    def covered(self, marker: int, reach_px: float, t_us: tuple[int, int]) -> list[EventPacket]:
        """Return the events without those around a marker's rest, while something covers it."""
        out = []
        for packet in self.packets:
            place = packet.x - self.reference_px[marker, 0], packet.y - self.reference_px[marker, 1]
            near = (np.hypot(*place) < reach_px) & (packet.t >= t_us[0]) & (packet.t < t_us[1])
            out.append(packet.select(~near))
        return out

    def source(self) -> PacketSource:
        """Return the events as a source that can be read more than once."""
        return PacketSource(self.packets, self.size)


def _slides_of_a_plate(dx_mm: float, dy_mm: float) -> dict[str, Any]:
    segments = [
        {"kind": "press", "depth_mm": 0.1, "duration_s": 0.12},
        {"kind": "slide", "dx_mm": dx_mm, "dy_mm": dy_mm, "duration_s": 0.3},
        {"kind": "slide", "dx_mm": -dx_mm, "dy_mm": -dy_mm, "duration_s": 0.3},
        {"kind": "lift", "height_mm": 0.1, "duration_s": 0.08},
    ]
    return {"indenter": PLATE, "pause_s": 0.15, "motion": {"height_mm": 0.1, "segments": segments}}


def slides_scene(sensor: Mapping[str, Any] = SENSOR, slides: int = 4) -> Scene:
    """Return slides of the whole skin, to and fro: to four sides, or to fewer."""
    ways = ((OUT_MM, 0.0), (-OUT_MM, 0.0), (0.0, OUT_MM), (0.0, -OUT_MM))
    contacts = [_slides_of_a_plate(*way) for way in ways[:slides]]
    tree = {**sensor} | {"lead_in_s": 0.2, "lead_out_s": LAST_LEAD_S, "contacts": contacts}
    return build(Scene, tree, "small twin")


def _filmed(scene: Scene, seed: int) -> Film:
    source = SceneSource(scene, seed=seed)
    steps = list(source.steps())
    return Film(
        tuple(step.packet for step in steps),
        source.size,
        source.reference_px,
        source.radius_px,
        TruthChunk(*map(np.concatenate, zip(*(step.truth for step in steps), strict=True))),
    )


@cache
def slides() -> Film:
    """Return the events and the truth of :func:`slides_scene`."""
    return made_once("small_twin_slides", lambda: _filmed(slides_scene(), SLIDES_SEED))


@cache
def touches() -> Film:
    """Return slow and fast motion, a release and a twist, of the sensor of :func:`slides`."""
    scene = build(Scene, TOUCHES, "small twin")
    return made_once("small_twin_touches", lambda: _filmed(scene, TOUCHES_SEED))


@cache
def calibration() -> Calibration:
    """Return what a user would have: the calibration from the slides' events, not the truth."""
    return made_once("small_twin_calibration", lambda: calibrate(slides().source()))
