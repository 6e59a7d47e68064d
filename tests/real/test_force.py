"""Forces of a real gel, each series from the other two: the table of the how-to on forces."""

from pathlib import Path

import numpy as np

from spikingtac.touch.force.fit import fit_force
from spikingtac.touch.force.regression import r_squared
from spikingtac.touch.series import load_series

SERIES = ("contacts_175756", "contacts_180422", "contacts_180917")

# R2 of Fx, Fy, Fz over the pooled series; measured 0.954, 0.951, 0.898.
POOLED = (0.95, 0.947, 0.895)


def test_each_series_from_the_other_two(data_dir: Path) -> None:
    series = [load_series(data_dir / "force" / f"{name}.npz") for name in SERIES]
    truth, estimates, inside = [], [], []
    for left_out in series:
        model = fit_force([one for one in series if one is not left_out])
        values, widths = model.estimate(left_out)
        truth.append(left_out.wrench[:, :3])
        estimates.append(values[:, :3])
        inside.append(np.abs(truth[-1] - estimates[-1]) <= widths[:, :3])
        each = [r_squared(truth[-1][:, k], estimates[-1][:, k]) for k in range(3)]
        assert min(each) >= 0.5, left_out.name
    pooled_truth, pooled = np.concatenate(truth), np.concatenate(estimates)
    found = [r_squared(pooled_truth[:, k], pooled[:, k]) for k in range(3)]
    assert (np.array(found) >= POOLED).all(), found
    coverage = np.concatenate(inside).mean(axis=0)
    assert ((coverage >= 0.81) & (coverage <= 0.95)).all(), coverage
