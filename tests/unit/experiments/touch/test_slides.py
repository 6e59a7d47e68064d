"""Drawn contacts: a carried body stays about its place; markers on a slack string lag behind."""

from __future__ import annotations

import numpy as np

from spikingtac.experiments.touch.slides import (
    CARRY,
    CARRY_MM,
    CARRY_MOVES,
    HOLD,
    HOLD_S,
    KINDS,
    draw_slide,
)
from spikingtac.experiments.touch.watched_slides import WatchedSlide, with_slack

SLACK_PX = 0.25


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


def watched(moved: np.ndarray) -> WatchedSlide:
    frames = len(moved)
    flags = np.ones(frames, np.bool_)
    slide = draw_slide(np.random.default_rng(0))
    t_us = 1_000 * np.arange(frames)
    return WatchedSlide(slide, np.zeros((1, 2)), t_us, moved, flags, np.ones(frames), flags)


def test_what_turns_back_is_not_seen_at_once() -> None:
    there_and_back = np.concatenate([np.linspace(0.0, 2.0, 21), np.linspace(1.9, 0.0, 20)])
    moved = np.column_stack([there_and_back, np.zeros(41)])[:, None]
    seen = with_slack(watched(moved), SLACK_PX).moved_px[:, 0, 0]
    np.testing.assert_allclose(seen[20], 2.0 - SLACK_PX)
    np.testing.assert_allclose(seen[21:25], 2.0 - SLACK_PX)  # 0.4 px back: within the string
    np.testing.assert_allclose(seen[26:], there_and_back[26:] + SLACK_PX)


def test_without_slack_everything_is_seen() -> None:
    moved = np.random.default_rng(1).normal(size=(30, 4, 2))
    np.testing.assert_allclose(with_slack(watched(moved), 0.0).moved_px, moved)
