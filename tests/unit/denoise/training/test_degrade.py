import numpy as np
import pytest

from spikingtac.types import EventPacket
from spikingtac_paper.training.dataset import with_background, with_drops
from stand_ins.denoiser_training import SIZE, SPAN_US, moving_disc


def test_background_has_its_rate_and_both_signs_alike():
    silence = EventPacket.empty(0, 4_000_000, SIZE)
    noisy = with_background(silence, 5.0, np.random.default_rng(1))
    expected = 5.0 * SIZE[0] * SIZE[1] * 4
    assert len(noisy) == pytest.approx(expected, abs=4 * expected**0.5)
    assert noisy.p.mean() == pytest.approx(0.5, abs=0.01)
    assert noisy.x.max() == SIZE[0] - 1
    assert noisy.y.max() == SIZE[1] - 1


def test_background_keeps_every_event_and_the_invariants():
    events = moving_disc().events
    noisy = with_background(events, 3.0, np.random.default_rng(1))
    noisy.sound()
    assert (np.diff(noisy.t) >= 0).all()
    assert noisy.t_start_us <= noisy.t[0] <= noisy.t[-1] < noisy.t_end_us
    there = {*zip(noisy.t.tolist(), noisy.x.tolist(), noisy.y.tolist(), strict=True)}
    assert there >= {*zip(events.t.tolist(), events.x.tolist(), events.y.tolist(), strict=True)}


def test_nothing_to_do_returns_the_packet_itself():
    events = moving_disc().events
    random = np.random.default_rng(1)
    assert with_background(events, 0.0, random) is events
    assert with_drops(events, 0.0, random) is events


def test_drops_have_their_share():
    many = with_background(EventPacket.empty(0, SPAN_US, SIZE), 50.0, np.random.default_rng(1))
    kept = with_drops(many, 0.3, np.random.default_rng(2))
    assert len(kept) / len(many) == pytest.approx(0.7, abs=0.01)
