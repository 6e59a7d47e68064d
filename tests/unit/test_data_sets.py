"""Statistics against NumPy over all frames at once."""

import numpy as np

from spikingtac.datasets.lerobot import QUANTILES, merged, statistics_of


def test_merged_statistics_are_those_of_all_frames() -> None:
    rng = np.random.default_rng(1)
    parts = [rng.normal(n, 1.0 + n, (20 + 30 * n, 3)) for n in range(4)]
    whole, found = np.concatenate(parts), merged([statistics_of(part) for part in parts])
    for name in ("min", "max", "mean", "std"):
        np.testing.assert_allclose(found[name], getattr(whole, name)(axis=0), rtol=1e-12)
    assert found["count"].tolist() == [len(whole)]


def test_quantiles_are_exact_in_an_episode_and_weighed_over_episodes() -> None:
    one, two = np.arange(101.0)[:, None], np.full((303, 1), 8.0)
    assert statistics_of(one)["q10"].tolist() == [10.0]
    found = merged([statistics_of(one), statistics_of(two)])
    assert found["q90"].tolist() == [(90.0 * 101 + 8.0 * 303) / 404]
    assert set(QUANTILES) == {"q01", "q10", "q50", "q90", "q99"}


def test_one_frame_has_statistics() -> None:
    found = statistics_of(np.array([[2, 3]]))
    assert found["std"].tolist() == [0.0, 0.0]
    assert found["q99"].tolist() == [2.0, 3.0]
