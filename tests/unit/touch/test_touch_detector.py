"""Touches from synthetic marker frames whose begin and end are known."""

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest

from spikingtac.touch.detector import SCATTER_PX, START_STRENGTH, TouchDetector
from spikingtac.touch.touch import Touch
from spikingtac.types import MarkerFrame
from stand_ins.pressed_skin import CENTER, PITCH_PX, REFERENCE, press, pulse, watch
from stand_ins.pressed_skin import touches as found_touches

PLACES_ONLY = "mm"  # Sensors that see places and not changes.


@pytest.fixture(autouse=True)
def scatter_of_an_event_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("spikingtac.touch.detector.SCATTER_SHARE", SCATTER_PX / PITCH_PX)


def touches(frames: Iterator[MarkerFrame]) -> list[Touch]:
    return found_touches(TouchDetector(REFERENCE, PLACES_ONLY), frames)


def test_two_presses_are_two_touches_in_time_and_place() -> None:
    found = touches(watch(lambda t: 4 * pulse(t, 0.8, 1.9) + 2 * pulse(t, 2.6, 3.4), 4.5))
    begins = [touch.begin_us / 1e6 for touch in found]
    ends = [(touch.end_us or 0) / 1e6 for touch in found]
    assert begins == pytest.approx([0.8, 2.6], abs=0.010)
    assert ends == pytest.approx([1.9, 3.4], abs=0.1)
    for touch in found:
        np.testing.assert_allclose(touch.place_px, CENTER, atol=0.5 * PITCH_PX)
        assert touch.duration_us == (touch.end_us or 0) - touch.begin_us


def test_what_remains_after_a_release_is_no_touch() -> None:
    def creeping(t: float) -> float:
        return 4 * pulse(t, 0.8, 2.0) + float(0.5 * np.exp(-(t - 1.9) / 0.4) if t > 1.9 else 0.0)

    assert len(touches(watch(creeping, 5.0))) == 1


def test_noise_and_drift_are_no_touch() -> None:
    assert touches(watch(lambda t: 0.0, 4.0, drift=0.3)) == []


def test_a_slow_press_is_a_touch_and_hides_no_tap_after_it() -> None:
    frames = watch(lambda t: 6 * pulse(t, 1, 13, 5.0) + 2 * pulse(t, 14, 14.2, 0.1), 15.0)
    slow, tap = touches(frames)
    assert slow.begin_us < 6_000_000 < slow.peak_us < 8_000_000
    assert tap.begin_us / 1e6 == pytest.approx(14.0, abs=0.02)


def test_a_gel_that_creeps_off_its_calibrated_rest_is_at_rest() -> None:
    strength = TouchDetector(REFERENCE)._gradient.strength_of(press(-2.4))
    assert 0.03 < strength < START_STRENGTH, "as on the recorded gel"
    (touch,) = touches(watch(lambda t: 4 * pulse(t, 0.8, 1.9) + 0.3 * min(t, 0.8) - 2.4, 4.0))
    assert touch.begin_us / 1e6 == pytest.approx(0.8, abs=0.010)


def test_a_recording_may_begin_with_a_touch() -> None:
    first, second = touches(watch(lambda t: 4 * pulse(t, 0.0, 0.9) + 4 * pulse(t, 1.3, 2.2), 3.0))
    assert first.begin_us < 100_000
    assert [first.end_us, second.end_us] == pytest.approx([900_000, 2_200_000], abs=100_000)


@pytest.mark.parametrize(("later_s", "told"), [(0.08, 1), (0.6, 2)])
def test_a_faint_strain_right_after_a_release_belongs_to_it(later_s: float, told: int) -> None:
    def tailed(t_s: float) -> float:
        begin_s = 1.8 + later_s
        return 6 * pulse(t_s, 0.8, 1.8, 0.05) + 0.9 * pulse(t_s, begin_s, begin_s + 0.6, 0.05)

    assert len(touches(watch(tailed, 5.0))) == told


@pytest.mark.parametrize("rise_s", [0.03, 0.1])
def test_a_faint_touch_begins_and_ends_though_the_tracker_keeps_half_of_it(rise_s: float) -> None:
    """As trackers do that see only changes: presses that hardly exceed the threshold."""

    def faint(t_s: float) -> float:
        return max(0.45 * pulse(t_s, 0.8, 1.9, rise_s), 0.25 if t_s > 0.8 + rise_s else 0.0)

    (touch,) = touches(watch(faint, 3.0))
    assert touch.peak_strength < 2.0 * TouchDetector(REFERENCE).threshold
    assert touch.begin_us / 1e6 == pytest.approx(0.8, abs=0.010)
    assert touch.end_us is not None
    assert touch.end_us / 1e6 == pytest.approx(1.9, abs=0.1)


def test_markers_that_are_lost_in_the_release_do_not_hold_the_touch() -> None:
    def stuck(frame: MarkerFrame) -> MarkerFrame:
        place = frame.detected_px.copy()
        if frame.t_us > 1_900_000:
            place[[20, 28, 36]] = (REFERENCE + press(4.0))[[20, 28, 36]] + (6.0, 0.0)
        return dataclasses.replace(frame, detected_px=place)

    found = touches(stuck(f) for f in watch(lambda t: 4 * pulse(t, 0.8, 2.0), 4.0))
    assert len(found) == 1
    assert found[0].end_us is not None


def test_markers_at_a_sharp_rim_are_tracked_though_they_look_lost() -> None:
    away2 = ((REFERENCE - REFERENCE[27]) ** 2).sum(axis=1, keepdims=True) / (0.5 * PITCH_PX) ** 2
    sharp = 12.0 * np.exp(-0.5 * away2) * (1.0, 0.0)  # a small body that is dragged

    def dragged(frame: MarkerFrame) -> MarkerFrame:
        place = frame.detected_px + min(max(1e-6 * frame.t_us - 0.5, 0.0), 1.0) * sharp
        place[50] += 20.0, 5.0  # a tracker that holds on to something else
        return dataclasses.replace(frame, detected_px=place)

    detector, frames = TouchDetector(REFERENCE), [*map(dragged, watch(lambda t: 0.0, 2.0))]
    steps, last = [], detector.tracked_px
    for frame in frames:
        detector.update(frame)
        steps.append(np.abs(detector.tracked_px - last).max())
        last = detector.tracked_px
    assert detector.touching
    np.testing.assert_allclose(detector.tracked_px[27], [12.0, 0.0], atol=0.5)
    assert np.abs(detector.displacement_px[27]).max() < 6.0
    assert np.abs(detector.tracked_px[50]).max() < 1.0
    assert max(steps[10:]) < 0.5


@pytest.mark.parametrize("markers", [[27], [27, 28], [0, 1]])
@pytest.mark.parametrize("px", [1.0, 4.0])
def test_markers_that_err_by_themselves_touch_nothing(markers: list[int], px: float) -> None:
    """A touch moves the skin about its place; a tracker's fault moves one or two markers."""

    def frames() -> Iterator[MarkerFrame]:
        for k, frame in enumerate(watch(lambda _: 0.0, 3.0)):
            if 500 <= k < 1_000:
                frame.detected_px[markers] += [px, 0.0]
            yield frame

    assert touches(frames()) == []


def test_a_shift_of_all_markers_with_a_trackers_errors_is_no_touch() -> None:
    """Markers under a plate that shifts the skin; the tracker errs by 4 % of the shift."""
    errors = np.random.default_rng(5).normal(0.0, 0.04, REFERENCE.shape)

    def shifted(frame: MarkerFrame) -> MarkerFrame:
        shift_px = 15.0 * pulse(1e-6 * frame.t_us, 0.8, 1.9)
        return dataclasses.replace(
            frame, detected_px=frame.detected_px + shift_px * (np.array([1.0, 0.0]) + errors)
        )

    assert touches(shifted(frame) for frame in watch(lambda t: 0.0, 3.0)) == []
    found = touches(shifted(frame) for frame in watch(lambda t: 4 * pulse(t, 0.8, 1.9), 3.0))
    assert len(found) == 1, "a press during the shift strains the skin"
