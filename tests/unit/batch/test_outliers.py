"""Outliers against SciPy's median absolute deviation and against values by hand."""

import numpy as np
import pytest
from scipy.stats import median_abs_deviation

from spikingtac.batch.outliers import LIMIT, scores, unlike


def test_the_score_is_the_modified_z_score() -> None:
    values = np.random.default_rng(1).normal(5.0, 2.0, 31)
    expected = np.abs(values - np.median(values)) / median_abs_deviation(values, scale="normal")
    np.testing.assert_allclose(scores(values), expected, rtol=1e-4)


def test_where_most_values_are_equal_the_mean_deviation_decides() -> None:
    values = np.array([0.0] * 9 + [10.0])
    assert scores(values)[-1] == pytest.approx(10.0 / (1.2533 * 1.0))  # their mean deviation is 1
    assert not scores(np.full(9, 3.0)).any()


def test_rows_name_their_odd_figures_the_largest_first() -> None:
    rows = [{"a": 1.0 + 0.01 * i, "b": 5 + i % 2, "c": "text"} for i in range(9)]
    rows.append({"a": 9.0, "b": 90, "c": "other"})
    found = unlike(rows)
    assert found[:-1] == [{}] * 9
    assert list(found[-1]) == sorted(found[-1], key=lambda name: -found[-1][name])
    assert set(found[-1]) == {"a", "b"}
    assert min(found[-1].values()) > LIMIT


def test_missing_figures_and_few_rows_say_nothing() -> None:
    assert unlike([{"a": 1.0}, {"a": 1.0}, {"a": 99.0}]) == [{}, {}, {}]
    rows = [{"a": float(i)} for i in range(6)] + [{}, {"a": None}]
    assert unlike(rows) == [{}] * 8
    assert unlike([]) == []
