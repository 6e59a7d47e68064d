"""Markers that a tracker has lost, and what an event camera does not see."""

import numpy as np
import pytest

from spikingtac.touch.lost_markers import EVERY, LostMarkers
from spikingtac.touch.onset import STRING_PX, UNSEEN_LATER_PX, UNSEEN_REVERSED_PX, unseen_px

X, Y = np.meshgrid(np.arange(8.0), np.arange(8.0))
REFERENCE = 37.0 * np.column_stack([X.ravel(), Y.ravel()])


def press(depth: float) -> np.ndarray:
    away = (REFERENCE - REFERENCE.mean(axis=0)) / 37.0
    return depth * away * np.exp(-0.25 * (away**2).sum(axis=1, keepdims=True))


def test_a_lost_marker_takes_its_neighbours_displacement() -> None:
    moved = press(0.2)
    wrong = moved.copy()
    wrong[[19, 27]] += (7.0, 0.0)
    repaired = LostMarkers(REFERENCE).repaired(wrong)
    np.testing.assert_allclose(repaired, moved, atol=0.3)
    kept = np.delete(np.arange(64), [19, 27])
    np.testing.assert_array_equal(repaired[kept], wrong[kept])


def test_a_press_loses_no_marker() -> None:
    moved = press(8.0)
    assert LostMarkers(REFERENCE).repaired(moved) is moved


def test_a_lost_marker_is_believed_again_only_when_it_is_well_back() -> None:
    lost = LostMarkers(REFERENCE)
    found = []
    for away in (7.0, 1.0, 0.3, 1.0):
        moved = np.zeros((64, 2))
        moved[20, 1] = away
        for _ in range(EVERY):
            lost.repaired(moved)
        found.append(not lost.lost[20])
    assert found == [False, False, True, True]


def test_more_is_unseen_after_a_reversal() -> None:
    string = np.full((4, 2), (STRING_PX, 0.0))
    onward, back = np.full((4, 2), (1.0, 0.0)), np.full((4, 2), (-1.0, 0.0))
    assert unseen_px(string, onward) == pytest.approx(UNSEEN_LATER_PX)
    assert unseen_px(string, back) == pytest.approx(UNSEEN_LATER_PX + UNSEEN_REVERSED_PX)
    assert unseen_px(0 * string, back) == 0.0
