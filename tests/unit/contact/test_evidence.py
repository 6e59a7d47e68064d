"""Evidence of rims, and thresholds from quiet windows: hot pixels, tails, the leak's bias."""

import math
from dataclasses import replace

import numpy as np
import pytest

from spikingtac.contact.evidence import AFFINE_MODES, OFF_RIM, ScaleSums, rim_table
from spikingtac.contact.quiet_evidence import quiet_evidence, scale_test, tail_threshold
from spikingtac.types import EventPacket
from stand_ins.moving_rims import GRID, RADIUS_PX, SIZE, calibration, windows
from stand_ins.random_packets import packet_of

BLOCK, PER_BLOCK = 100, 1e-5
TABLE = rim_table(calibration())
HOT = (round(GRID[4][0]) + 7, round(GRID[4][1]))


def with_hot_pixel(packet: EventPacket) -> EventPacket:
    if packet.t_start_us % 20_000:
        return packet
    columns = np.array([[packet.t_start_us], [HOT[0]], [HOT[1]], [1]])
    extra = packet_of(*columns, packet.size, (packet.t_start_us, packet.t_end_us))
    return EventPacket.concatenate([extra, packet])


def test_hot_pixels_on_the_rims_lose_their_say() -> None:
    quiet = quiet_evidence([TABLE], map(with_hot_pixel, windows(3000, seed=1)))
    assert quiet.hot_pixels == (1,)
    assert TABLE.row[HOT[1], HOT[0]] != OFF_RIM
    assert quiet.tables[0].row[HOT[1], HOT[0]] == OFF_RIM


def test_whitened_evidence_of_other_quiet_windows_has_unit_variance_at_most() -> None:
    test = scale_test(quiet_evidence([TABLE], windows(6000, seed=1)), 1.0)
    fresh = quiet_evidence([TABLE], windows(6000, seed=2)).evidence
    sums = ScaleSums(test)
    values = np.array([sums.add(evidence).copy() for evidence in fresh])[256:]
    # A chi-square of six; below it where the long scales leave room for the leak.
    assert values.mean(axis=0)[:6] == pytest.approx(AFFINE_MODES, rel=0.35)
    assert (values.mean(axis=0) < 1.4 * AFFINE_MODES).all()


def test_a_leading_rim_that_brightens_is_evidence_for_the_motion() -> None:
    x, y = GRID[4]
    for offset, normal in (((8, 0), (1, 0)), ((-8, 0), (-1, 0)), ((0, 7), (0, 1))):
        row = TABLE.row[round(y) + offset[1], round(x) + offset[0]]
        assert TABLE.modes[row, :2] == pytest.approx(normal)
    assert TABLE.row[round(y), round(x)] == OFF_RIM
    dark = rim_table(replace(calibration(), polarity="dark"))
    np.testing.assert_array_equal(dark.modes, -TABLE.modes)


def test_only_the_rims_count_and_each_pixel_belongs_to_the_nearest() -> None:
    rows, columns = np.nonzero(TABLE.row != OFF_RIM)
    distance = np.hypot(columns[:, None] - GRID[:, 0], rows[:, None] - GRID[:, 1])
    depth = distance.min(axis=1) - RADIUS_PX
    assert depth.min() >= -2.0
    assert depth.max() <= 3.0
    offset = np.column_stack([columns, rows]) - GRID[distance.argmin(axis=1)]
    outward = offset / distance.min(axis=1)[:, None]
    modes = TABLE.modes[TABLE.row[rows, columns]]
    np.testing.assert_allclose(modes[:, :2], outward, atol=1e-6)
    away = np.sign(distance.min(axis=1) - RADIUS_PX)
    np.testing.assert_allclose(modes[:, -1], away - away.mean(), atol=1e-6)
    none = TABLE.without(np.ones((SIZE[1], SIZE[0]), np.bool_))
    assert (none.row == OFF_RIM).all()


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
    later = draw(np.random.default_rng(100 + seed), 200_000)
    assert (later > threshold).mean() <= PER_BLOCK


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
