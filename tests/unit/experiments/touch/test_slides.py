"""Drawn contacts: a carried body stays about its place."""

from __future__ import annotations

import numpy as np

from spikingtac_paper.touch.slides import (
    CARRY,
    CARRY_MM,
    CARRY_MOVES,
    HOLD,
    HOLD_S,
    KINDS,
    draw_slide,
)


def test_a_carried_body_stays_near_its_place_and_ends_every_move_at_rest() -> None:
    for seed in range(5):
        slide = draw_slide(np.random.default_rng(seed), kinds=(CARRY,))
        moves = [s for s in slide.scene.contacts[0].motion.segments if s.kind == "slide"]
        assert len(moves) == CARRY_MOVES
        steps = np.array([[move.dx_mm, move.dy_mm] for move in moves], np.float64)
        away = np.sqrt((np.cumsum(steps, axis=0) ** 2).sum(axis=1))
        assert away.max() <= CARRY_MM * slide.friction + 1e-9


def test_carrying_and_holding_are_drawn_only_where_they_are_asked_for() -> None:
    assert not {CARRY, HOLD} & set(KINDS)


def test_a_held_body_does_not_move_for_long() -> None:
    segments = draw_slide(np.random.default_rng(1), kinds=(HOLD,)).scene.contacts[0].motion.segments
    assert [one.kind for one in segments] == ["press", "hold", "hold", "hold", "lift"]
    assert max(one.duration_s or 0.0 for one in segments) == HOLD_S
