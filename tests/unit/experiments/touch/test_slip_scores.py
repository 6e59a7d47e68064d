"""Scores of slip alarms on made-up truths, drawn contacts, and the simpler way."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.sim.scene.timeline import Timeline
from spikingtac_paper.touch.bodies import ROUND, TAUGHT, TESTED
from spikingtac_paper.touch.slides import KINDS, Slide, draw_slide
from spikingtac_paper.touch.slip_scores import Truth, slip_scores
from spikingtac_paper.touch.twin_slip import alarms_of, held_truth_of, shift_stops, truth_of
from spikingtac_paper.touch.watched_slides import WatchedSlide, watch_slide


def truth(slow: bool = True) -> Truth:
    """A contact of 1 s that holds until 400 ms and has slipped at 600 ms."""
    t_us = np.arange(0, 1_000_000, 1_000)
    share = np.interp(t_us, [0, 400_000, 600_000, 1_000_000], [1.0, 1.0, 0.0, 0.0])
    return Truth(t_us, share, np.ones(len(t_us), np.bool_), slow)


def test_alarms_in_time_are_right() -> None:
    scores = slip_scores(truth(), [450_000], [598_000])
    assert scores["gross_in_time"] == scores["lead_20ms"] == 1.0
    assert scores["gross_delay_ms"] == pytest.approx(7.0, abs=2.0)
    assert scores["false_incipient"] == scores["false_gross"] == 0.0
    assert scores["sticking_s"] == pytest.approx(0.42, abs=0.01)


def test_late_alarms_are_late() -> None:
    scores = slip_scores(truth(), [585_000], [620_000])
    assert scores["gross_in_time"] == scores["lead_20ms"] == 0.0


def test_alarms_of_a_contact_that_sticks_are_false() -> None:
    scores = slip_scores(truth(), [50_000], [200_000])
    assert scores["false_incipient"] == scores["false_gross"] == 1.0
    assert scores["false_gross_sticking"] == 1.0
    assert scores["gross_in_time"] == scores["lead_20ms"] == 0.0
    assert "gross_delay_ms" not in scores


def test_an_alarm_of_a_contact_that_slips_in_part_is_early_rather_than_false() -> None:
    share = np.where(np.arange(1_000) < 400, 1.0, 0.5)
    known = Truth(np.arange(0, 1_000_000, 1_000), share, np.ones(1_000, np.bool_), slow=True)
    scores = slip_scores(known, [], [600_000])
    assert (scores["false_gross"], scores["false_gross_sticking"]) == (1.0, 0.0)


def test_an_early_warning_of_a_slip_is_not_false() -> None:
    assert slip_scores(truth(), [380_000], [])["false_incipient"] == 0.0


def test_fast_slides_need_no_lead() -> None:
    assert "lead_20ms" not in slip_scores(truth(slow=False), [450_000], [598_000])


@pytest.mark.parametrize("kind", sorted(set(KINDS)))
def test_every_kind_of_contact_can_be_drawn_again(kind: str) -> None:
    drawn = [draw_slide(np.random.default_rng(3), TESTED, (0.3, 0.9), (kind,)) for _ in range(2)]
    assert drawn[0] == drawn[1]
    assert drawn[0].friction in (0.3, 0.9)
    assert drawn[0].kind == kind
    assert 0.5 < Timeline(drawn[0].scene, 0).duration_s < 12.0


def test_bodies_that_are_tested_were_not_all_taught() -> None:
    assert {body.name for body in TESTED} - {body.name for body in TAUGHT} == {"spoon"}


@pytest.fixture(scope="module")
def slid() -> WatchedSlide:
    """A finger that is dragged until it slips, as camera and tracker see it."""
    for seed in range(100):
        slide = draw_slide(np.random.default_rng(seed), ROUND[2:], (0.5,), ("slide",))
        if 8.0 < slide.speed_mm_s < 20.0:
            return watch_slide(slide, seed)
    raise AssertionError("no slide of a middle speed was drawn")


def test_a_slide_on_the_twin_is_told(slid: WatchedSlide) -> None:
    known = truth_of(slid)
    assert known.slow
    assert known.judged.sum() > 200
    incipient, gross = alarms_of("slip", slid)
    assert incipient[0] < gross[0]
    scores = slip_scores(known, incipient, gross)
    assert scores["false_incipient"] == scores["false_gross"] == 0.0
    assert abs(scores["gross_delay_ms"]) < 60.0


def test_what_a_standing_body_holds_is_not_judged_after_a_slip(slid: WatchedSlide) -> None:
    holding = slid.t_us > slid.t_us[-1] - 380_000
    before_release = slid.t_us < slid.t_us[-1] - 320_000
    assert not slid.judged[holding & before_release].any()


def test_alarms_of_a_body_that_stands_count_where_it_is_held(slid: WatchedSlide) -> None:
    known = held_truth_of(slid)
    holding = (slid.t_us > slid.t_us[-1] - 380_000) & (slid.t_us < slid.t_us[-1] - 320_000)
    released = slid.t_us > slid.t_us[-1] - 280_000
    assert known.judged[holding].all()
    assert not known.judged[released].any()
    assert not known.slow


def test_the_simpler_way_tells_where_a_shift_stops() -> None:
    t_us = np.arange(0, 1_000_000, 1_000)
    shift = np.interp(t_us, [0, 300_000, 600_000, 1_000_000], [0.0, 0.0, 6.0, 6.0])
    moved = np.repeat(shift[:, None, None], 4, axis=1) * np.array([1.0, 0.0])
    scene: Slide = draw_slide(np.random.default_rng(1))
    on = np.ones(len(t_us), np.bool_)
    watched = WatchedSlide(scene, np.zeros((4, 2)), t_us, moved, on, 0.0 * shift, on)
    (told_us,) = shift_stops(watched)
    assert told_us == pytest.approx(615_000, abs=6_000)
