"""Recovery is believed only where it explains the events better."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from spikingtac.markers.calibration.refinement import recovery


@pytest.mark.parametrize(
    ("factor", "on", "recovers"),
    [(0.87, 3, True), (0.97, 3, False), (1.26, 3, False), (0.87, 2, False)],
)
def test_recovery_must_explain_the_events_better_and_off_events_must_be_missing(
    monkeypatch: pytest.MonkeyPatch, factor: float, on: int, recovers: bool
) -> None:
    from spikingtac.markers.calibration.course import Course, PixelSteps
    from spikingtac.markers.calibration.disc_levels import Discs
    from spikingtac.markers.calibration.refinement.refine import Refined

    one, none = np.ones(1), np.zeros((1, 1))
    course = Course(np.zeros(1, np.int64), np.zeros((1, 1, 2)), none)
    steps = PixelSteps(none.astype(np.float32), none.astype(np.float32))
    before = Refined(
        course, np.zeros(1, np.int64), Discs(one, one, 3.0 * one), one, one, steps, one, none
    )

    def refined(_: object, start: Refined, *about: object) -> Refined:
        assert start.recovery_s == recovery.RECOVERY_S
        return replace(start, residual=factor * start.residual)

    monkeypatch.setattr(recovery, "refine", refined)
    events = SimpleNamespace(code=(np.arange(4) < on).astype(np.uint32))
    found = recovery.with_recovery(events, before, *[np.zeros(1)] * 3)
    assert (found.recovery_s == recovery.RECOVERY_S) is recovers
    assert found.residual[0] == pytest.approx(factor if recovers else 1.0)
