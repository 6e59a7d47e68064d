"""Laws on kept estimates: what each does to exact detections, and who is told of contact."""

import numpy as np
import pytest

from spikingtac.markers.anchored_law import AnchoredLaw, ReZero
from spikingtac.markers.hysteresis import NoLaw, PaperLaw
from spikingtac_paper.trials.ground_truth import GroundTruth
from spikingtac_paper.trials.laws import (
    apply_law,
    compared_laws,
    law_rows,
    loop_drift_px,
    swept_laws,
)
from spikingtac_paper.trials.prediction import Prediction

REST = np.array([[50.0, 50.0], [90.0, 50.0]])
T_US = np.arange(0, 10_000_000, 2_000)


def stays_off(shift_px: float) -> Prediction:
    there = np.tile(REST + np.array([shift_px, 0.0]), (len(T_US), 1, 1)).astype(np.float32)
    return Prediction(T_US, there, there, np.zeros(there.shape[:2], np.bool_), REST)


def truth(free_us: np.ndarray) -> GroundTruth:
    course = np.tile(REST, (len(T_US), 1, 1))
    return GroundTruth(T_US, course, REST, np.full(2, 7.0), 0, free_us)


def test_the_published_law_drifts_on_a_loop_and_the_others_do_not() -> None:
    # (1 - gamma) delta sqrt(2), paper-notes: leave along x, come back along y.
    assert loop_drift_px(PaperLaw()) == pytest.approx(0.3 * 4.0 * np.sqrt(2.0), abs=0.03)
    for law in (NoLaw(), AnchoredLaw(), ReZero()):
        assert loop_drift_px(law) == pytest.approx(0.0, abs=1e-9)


def test_the_default_anchored_law_is_within_the_bounds_that_it_is_judged_by() -> None:
    told = {(row.method, row.metric): row.value for row in law_rows(compared_laws())}
    slope = told["default-law-anchored", "steepest_slope"]
    falsified = told["default-law-anchored", "worst_falsification_px"]
    assert slope is not None
    assert falsified is not None
    assert slope <= 1.9
    assert falsified <= 0.6
    assert told["default-law-paper", "worst_falsification_px"] is None, "it has no bound"


def test_a_sweep_has_no_law_twice() -> None:
    laws = [*compared_laws(), *swept_laws()]
    assert len({law.name for law in laws}) == len({law.key() for law in laws}) == len(laws)


def test_re_zero_learns_between_contacts_and_is_frozen_in_them() -> None:
    contact = truth(np.empty((0, 2), np.int64))
    free = truth(np.array([[0, 10_000_000]]))
    frozen, learnt = (apply_law(stays_off(0.6), ReZero(), one) for one in (contact, free))
    held_px = np.linalg.norm(frozen.position_px[-1] - REST, axis=1)
    faded_px = np.linalg.norm(learnt.position_px[-1] - REST, axis=1)
    assert held_px == pytest.approx(0.18, abs=1e-3)
    assert faded_px.max() < 0.01
    assert np.array_equal(learnt.detected_px, stays_off(0.6).detected_px)
