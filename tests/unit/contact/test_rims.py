"""What events on a rim say about the motion of their marker."""

from dataclasses import replace

import numpy as np
import pytest

from spikingtac.contact.evidence import (
    OFF_RIM,
    rim_table,
)
from stand_ins.moving_rims import GRID, RADIUS_PX, SIZE, calibration


def test_a_leading_rim_that_brightens_is_evidence_for_the_motion() -> None:
    table = rim_table(calibration())
    x, y = GRID[4]
    for offset, normal in (((8, 0), (1, 0)), ((-8, 0), (-1, 0)), ((0, 7), (0, 1))):
        row = table.row[round(y) + offset[1], round(x) + offset[0]]
        assert table.marker[row] == 4
        assert table.modes[row, :2] == pytest.approx(normal)
    assert table.row[round(y), round(x)] == OFF_RIM
    dark = rim_table(replace(calibration(), polarity="dark"))
    np.testing.assert_array_equal(dark.modes, -table.modes)


def test_only_the_rims_count_and_each_pixel_belongs_to_the_nearest() -> None:
    table = rim_table(calibration())
    rows, columns = np.nonzero(table.row != OFF_RIM)
    distance = np.hypot(columns[:, None] - GRID[:, 0], rows[:, None] - GRID[:, 1])
    depth = distance.min(axis=1) - RADIUS_PX
    assert depth.min() >= -2.0
    assert depth.max() <= 3.0
    np.testing.assert_array_equal(table.marker[table.row[rows, columns]], distance.argmin(axis=1))
    none = table.without(np.ones((SIZE[1], SIZE[0]), np.bool_))
    assert (none.row == OFF_RIM).all()
