"""A plate is drawn whole, also where a search ended with an error."""

from typing import Any

import numpy as np
import pytest

from spikingtac.sim.rig.wall_calibration import ANGLES_DEG, DEFAULT, WALL_MM
from spikingtac_paper.holes.figures import plate_figure
from spikingtac_paper.holes.jobs import RADII_MM

SEED = 3


def kept(reading_mm: np.ndarray, direction: np.ndarray) -> dict[str, Any]:
    return {
        "start_mm": [0.0, 0.0],
        "direction": direction.tolist(),
        "reading_mm": reading_mm.tolist(),
        "draw": [0.0, 0.0],
        "presses": 1,
    }


@pytest.mark.parametrize("touches", [0, 2])
def test_a_search_without_an_estimate_says_so(touches: int) -> None:
    angle = np.radians(np.tile(ANGLES_DEG[DEFAULT], 2))
    unit = np.column_stack([np.cos(angle), np.sin(angle)])
    calibration = {"seed": SEED, DEFAULT: [kept((WALL_MM - 0.3) * one, one) for one in unit]}
    made = [kept(0.3 * one, one) for one in unit[:touches]]
    failed = {"touches": made, "used": [], "error": "no wall"}
    records = [{"seed": SEED, "hole": hole, DEFAULT: failed} for hole in range(len(RADII_MM))]
    text = plate_figure(records, calibration, "default-4")
    assert text.count("no estimate") >= len(RADII_MM)
    assert text.count("true hole") == 1
    assert "simulated" in text
