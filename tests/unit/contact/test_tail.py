import math

import numpy as np
import pytest

from spikingtac.contact.quiet_evidence import _at_least_shorter, tail_threshold

BLOCK, PER_BLOCK = 100, 1e-5


def rate_above(threshold, draw, rng, blocks=200_000):
    return float((draw(rng, blocks) > threshold).mean())


def noise(rng, blocks):
    """The highest of a block of Gaussian noise."""
    return np.abs(rng.standard_normal((blocks, 4))).max(axis=1)


def noise_and_swings(rng, blocks):
    """Besides, one block in thirty holds a swing, most of them small."""
    swing = (rng.random(blocks) < 1 / 30) * (3.0 + rng.rayleigh(3.0, blocks))
    return np.maximum(noise(rng, blocks), swing)


@pytest.mark.parametrize("draw", [noise, noise_and_swings])
@pytest.mark.parametrize("seed", range(2))
def test_a_minute_tells_what_is_rarer_by_far(draw, seed):
    values = np.zeros((600, BLOCK))
    values[:, 7] = draw(np.random.default_rng(seed), len(values))
    threshold = tail_threshold(values.ravel(), BLOCK, PER_BLOCK)
    assert rate_above(threshold, draw, np.random.default_rng(100 + seed)) <= PER_BLOCK


def test_a_short_recording_gives_a_high_threshold_not_a_wrong_one():
    """Without its two standard errors, half of the thresholds would be too low where the tail is
    just as supposed. They leave 8 %: the mean excess of the few highest is skewed."""
    blocks, recordings = 200, 200
    wanted = -math.log(PER_BLOCK)  # what an exponential exceeds with this probability
    too_low = 0
    for seed in range(recordings):
        values = np.zeros((blocks, BLOCK))
        values[:, 3] = np.random.default_rng(seed).exponential(1.0, blocks)
        too_low += tail_threshold(values.ravel(), BLOCK, PER_BLOCK) < wanted
    assert too_low / recordings < 0.15


def test_swings_that_the_highest_twentieth_hides_are_seen():
    rng = np.random.default_rng(3)
    values = np.zeros((3000, BLOCK))
    values[:, 0] = noise(rng, len(values))
    calm = tail_threshold(values.ravel(), BLOCK, PER_BLOCK)
    values[:60, 0] = 5.0 + rng.exponential(4.0, 60)
    assert tail_threshold(values.ravel(), BLOCK, PER_BLOCK) > 4.0 * calm


def test_a_longer_sum_holds_what_a_shorter_one_held():
    whiten = np.eye(3)[None] / np.sqrt([1.0, 2.0, 4.0, 8.0])[:, None, None]
    raised = _at_least_shorter(np.array([9.0, 40.0, 5.0, 30.0]), whiten)
    np.testing.assert_allclose(raised, [9.0, 40.0, 20.0, 30.0])
