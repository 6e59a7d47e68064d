"""Simple models of forces, to compare with: linear ones and a plain multilayer perceptron."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch import WrenchSeries

Field = NDArray[np.float64]

# Penalty per frame, over the variance of a displacement (of 1e-4 to 1e-2 the least errors
# between the series of data/force).
RIDGE_SHARE = 1e-2

# Layers of the perceptron and how it is trained.
WIDTHS, DROPOUT, EPOCHS, BATCH = (512, 256, 128), 0.2, 70, 64
RATE, DECAY = 1e-3, 1e-4  # Its largest learning rate and the decay of its weights.


class MeanDisplacement:
    """Linear regression of the wrench on the markers' mean displacement and its length."""

    def __init__(self, series: Iterable[WrenchSeries]) -> None:
        """Learn from labelled series."""
        taught = list(series)
        features = np.concatenate([self._features(one) for one in taught])
        wrench = np.concatenate([one.wrench for one in taught])
        self._weights = np.linalg.lstsq(features, wrench, rcond=None)[0]

    def estimate(self, series: WrenchSeries) -> Field:
        """Return the wrench ``(n, c)`` of a series."""
        return self._features(series) @ self._weights

    @staticmethod
    def _features(series: WrenchSeries) -> Field:
        mean = series.displacement.mean(axis=1)
        length = np.sqrt((series.displacement**2).sum(axis=2)).mean(axis=1)
        return np.column_stack([mean, length, np.ones(len(mean))])


class LinearRidge:
    """Ridge regression of the wrench on all displacements."""

    def __init__(self, series: Iterable[WrenchSeries]) -> None:
        """Learn from labelled series."""
        rows, wrench = _stacked(series)
        self._middle, self._level = rows.mean(axis=0), wrench.mean(axis=0)
        away = rows - self._middle
        penalty = RIDGE_SHARE * len(away) * away.var() * np.eye(away.shape[1])
        self._weights = np.linalg.solve(away.T @ away + penalty, away.T @ (wrench - self._level))

    def estimate(self, series: WrenchSeries) -> Field:
        """Return the wrench ``(n, c)`` of a series."""
        return (_stacked([series])[0] - self._middle) @ self._weights + self._level


class Perceptron:
    """A plain multilayer perceptron on all displacements."""

    def __init__(self, series: Iterable[WrenchSeries]) -> None:
        """Train on labelled series."""
        import torch

        from spikingtac_paper.training.small_networks import Schedule, fit

        rows, wrench = _stacked(series)
        self._scale = rows.mean(axis=0), rows.std(axis=0), wrench.mean(axis=0), wrench.std(axis=0)
        torch.manual_seed(0)
        layers: list[torch.nn.Module] = []
        before = rows.shape[1]
        for width in WIDTHS:
            layers += [torch.nn.Linear(before, width), torch.nn.ReLU(), torch.nn.Dropout(DROPOUT)]
            before = width
        self._network = torch.nn.Sequential(*layers, torch.nn.Linear(before, wrench.shape[1]))
        known = torch.tensor((rows - self._scale[0]) / self._scale[1], dtype=torch.float32)
        wanted = torch.tensor((wrench - self._scale[2]) / self._scale[3], dtype=torch.float32)

        def batches() -> list[torch.Tensor]:
            return list(torch.randperm(len(known)).split(BATCH))

        def loss(network: torch.nn.Module, chosen: torch.Tensor) -> torch.Tensor:
            return (network(known[chosen]) - wanted[chosen]).square().mean()

        fit(self._network, batches, loss, Schedule(rate=RATE, decay=DECAY, epochs=EPOCHS))

    def estimate(self, series: WrenchSeries) -> Field:
        """Return the wrench ``(n, c)`` of a series."""
        import torch

        middle, spread, level, size = self._scale
        rows = torch.tensor((_stacked([series])[0] - middle) / spread, dtype=torch.float32)
        with torch.no_grad():
            return np.asarray(self._network(rows).numpy() * size + level, np.float64)


def _stacked(series: Iterable[WrenchSeries]) -> tuple[Field, Field]:
    """Return displacements ``(n, size)`` and wrenches ``(n, c)`` of series."""
    taught = list(series)
    rows = [one.displacement.reshape(len(one.displacement), -1) for one in taught]
    return np.concatenate(rows), np.concatenate([one.wrench for one in taught])


# Name -> what learns from series.
BASELINES = {"mlp": Perceptron, "ridge": LinearRidge, "mean-displacement": MeanDisplacement}
