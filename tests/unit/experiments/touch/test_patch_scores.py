"""Scores of contact patches on a made-up press."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spikingtac.touch.patch import SQUARE, Patch
from spikingtac_paper.touch.baselines import region_above
from spikingtac_paper.touch.twin_patches import (
    REGIONS,
    WatchedPress,
    draw_press,
    patch_scores,
    watch_press,
)

CELLS = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), axis=-1).reshape(-1, 2)
TOUCHED = (np.abs(CELLS - 9.5) < 4.0).all(axis=1)


def press() -> WatchedPress:
    """A true patch of eight by eight cells of a pixel each."""
    touch = watch_press(draw_press(np.random.default_rng(0))[1], "typical", 0).touch
    return WatchedPress(
        reference_px=CELLS,
        touch=touch,
        moved_px=np.zeros_like(CELLS),
        events=np.ones(len(CELLS)),
        cells_px=CELLS,
        touched=TOUCHED,
        cell_px2=np.ones(len(CELLS)),
        px_per_mm=2.0,
    )


def told(side: float, shift: float = 0.0) -> Patch:
    return Patch(np.full(2, 9.5 + shift), side**2, np.full(2, 9.5 + shift) + side * SQUARE)


@pytest.fixture(scope="module")
def watched() -> WatchedPress:
    return press()


def test_the_true_patch_scores_one(watched: WatchedPress) -> None:
    scores = patch_scores(watched, lambda _: told(8.0))
    assert scores["overlap"] == scores["overlap_asked"] == scores["area_ratio"] == 1.0
    assert scores["place_mm"] == scores["missed_presses"] == 0.0


def test_a_shifted_or_larger_patch_scores_less(watched: WatchedPress) -> None:
    shifted = patch_scores(watched, lambda _: told(8.0, shift=2.0))
    assert shifted["overlap"] == pytest.approx(36 / (64 + 64 - 36))
    assert shifted["overlap_asked"] == 0.0
    assert shifted["place_mm"] == pytest.approx(np.sqrt(2.0))
    larger = patch_scores(watched, lambda _: told(10.0))
    assert larger["overlap"] == pytest.approx(0.64)
    assert larger["area_ratio"] == pytest.approx(100 / 64)


def test_a_press_that_nobody_noticed_is_missed(watched: WatchedPress) -> None:
    assert patch_scores(replace(watched, touch=None), lambda _: told(8.0)) == {
        "missed_presses": 1.0
    }


def test_the_narrower_diameter_is_that_of_the_patch(watched: WatchedPress) -> None:
    assert watched.width_mm == pytest.approx(8.0 / 2.0 * 2.0 / np.sqrt(3.0), rel=0.02)


def test_simpler_methods_take_what_is_largest() -> None:
    grid = np.stack(np.meshgrid(np.arange(4.0), np.arange(4.0)), axis=-1).reshape(-1, 2)
    values = np.where((grid == [1.0, 2.0]).all(axis=1), 1.0, 0.1)
    patch = region_above(grid, values, 0.5)
    np.testing.assert_allclose(patch.place, [1.0, 2.0])
    assert patch.area == 1.0


@pytest.mark.parametrize("seed", [3, 4])
def test_every_method_tells_a_press_from_events_about_where_it_is(seed: int) -> None:
    name, scene = draw_press(np.random.default_rng(seed))
    assert draw_press(np.random.default_rng(seed)) == (name, scene)
    seen = watch_press(scene, "typical", seed)
    assert seen.touch is not None
    assert seen.touched.any()
    assert seen.events.sum() > 1_000
    scores = {method: patch_scores(seen, REGIONS[method]) for method in REGIONS}
    overlap = {method: scores[method]["overlap"] for method in REGIONS}
    assert overlap["patch-model"] > 0.7
    assert 0.4 < overlap["strained-region"] < overlap["patch-model"]
    assert 0.4 < overlap["event-region"] < overlap["patch-model"]
    assert scores["patch-model"]["place_mm"] < 0.4
    assert max(one["place_mm"] for one in scores.values()) < 1.5
