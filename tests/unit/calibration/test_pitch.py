"""The pitch is the usual distance to the nearest marker, whatever the grid."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.calibration.pitch import marker_pitch_px
from spikingtac.errors import ConfigError


def test_a_wide_grid_is_told_by_its_nearer_neighbours() -> None:
    x, y = np.meshgrid(np.arange(0.0, 120.0, 30.0), np.arange(0.0, 123.0, 41.0))
    assert marker_pitch_px(np.column_stack([x.ravel(), y.ravel()])) == 30.0


def test_a_marker_apart_does_not_move_it() -> None:
    line = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0], [200.0, 0.0]])
    assert marker_pitch_px(line) == 10.0


def test_one_marker_has_none() -> None:
    with pytest.raises(ConfigError, match="1 marker has no pitch, at least 2"):
        marker_pitch_px(np.zeros((1, 2)))
