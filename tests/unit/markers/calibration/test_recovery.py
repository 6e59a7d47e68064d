"""Recovery is believed only where it explains the events better."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from spikingtac.markers.calibration import recovery


@pytest.mark.parametrize(
    ("factors", "on", "recovers"),
    [
        ((1.05, 0.87), 3, True),
        ((1.05, 0.97), 3, False),
        ((1.2,), 3, False),  # and not gone on with
        ((), 2, False),
    ],
)
def test_recovery_must_explain_the_events_better_and_off_events_must_be_missing(
    monkeypatch: pytest.MonkeyPatch, factors: tuple[float, ...], on: int, recovers: bool
) -> None:
    from spikingtac.markers.calibration.disc_levels import Course, Discs, PixelSteps
    from spikingtac.markers.calibration.refine import MOST_ROUNDS, Refined

    one, none = np.ones(1), np.zeros((1, 1))
    course = Course(np.zeros(1, np.int64), np.zeros((1, 1, 2)), none)
    steps = PixelSteps(none.astype(np.float32), none.astype(np.float32))
    before = Refined(
        course, np.zeros(1, np.int64), Discs(one, one, 3.0 * one), one, one, steps, one, none
    )
    left_over, walked = list(factors), []

    def refined(_: object, start: Refined, *about: object) -> Refined:
        assert start.recovery_s == recovery.RECOVERY_S
        walked.append(about[-1])
        return replace(start, residual=left_over.pop(0) * before.residual)

    monkeypatch.setattr(recovery, "refine", refined)
    events = SimpleNamespace(code=(np.arange(4) < on).astype(np.uint32))
    found = recovery.with_recovery(events, before, *[np.zeros(1)] * 3)
    assert (found.recovery_s == recovery.RECOVERY_S) is recovers
    assert found.residual[0] == pytest.approx(factors[-1] if recovers else 1.0)
    assert not left_over
    assert len(walked) < 2 or sum(walked) == MOST_ROUNDS, "as often as without"
