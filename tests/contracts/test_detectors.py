"""One suite for every contact detector in the table."""

import copy
import json
from dataclasses import replace
from functools import cache
from itertools import islice

import numpy as np
import pytest

from spikingtac.contact.detector import ContactDetector, QuietStatistics, Window
from spikingtac.contact.registry import DetectionConfig, detectors, make_detector
from spikingtac.errors import CalibrationError, ConfigError
from spikingtac.events.windows import windows as cut_windows
from spikingtac.types import Contact, EventPacket
from stand_ins.moving_rims import PERIOD_US, SIZE, calibration, windows
from stand_ins.random_packets import cut_at

# Those of this package, and of every installed package that registers one.
NAMES = sorted(detectors())
TOUCH = 500  # Window in which the markers begin to move.


@pytest.fixture(params=NAMES)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


def push(window: int) -> tuple[float, float]:
    return (0.03, 0.01) if TOUCH <= window < TOUCH + 40 else (0.0, 0.0)


@cache
def quiet() -> tuple[EventPacket, ...]:
    return tuple(windows(3000, seed=1))


@cache
def touched() -> tuple[EventPacket, ...]:
    return tuple(windows(800, seed=2, speed=push))


@cache
def _built(name: str) -> ContactDetector:
    return make_detector(name, DetectionConfig(), [calibration()], quiet())


def build(name: str) -> ContactDetector:
    return copy.deepcopy(_built(name))


def found(detector: ContactDetector, stream: tuple[Window, ...]) -> list[Contact]:
    return [contact for window in stream if (contact := detector.update(window)) is not None]


def test_a_contact_is_told_once_at_the_end_of_its_window(name: str) -> None:
    detector = build(name)
    assert isinstance(detector, ContactDetector)
    assert not detector.in_contact
    (contact,) = found(detector, touched()[: TOUCH + 60])
    assert TOUCH * PERIOD_US < contact.t_us <= (TOUCH + 5) * PERIOD_US
    assert contact.t_us % PERIOD_US == 0
    assert contact.count > contact.threshold > 0.0
    assert detector.in_contact


def test_noise_is_no_contact(name: str) -> None:
    assert found(build(name), tuple(windows(4000, seed=3))) == []


def test_silence_is_data_and_no_contact(name: str) -> None:
    detector = build(name)
    silence = tuple(EventPacket.empty(1000 * k, 1000 * (k + 1), SIZE) for k in range(600))
    assert found(detector, silence) == []


def test_reset_forgets_the_windows_and_keeps_the_calibration(name: str) -> None:
    detector = build(name)
    first = found(detector, touched())
    detector.reset()
    assert not detector.in_contact
    assert found(detector, touched()) == first


@pytest.mark.parametrize("length_us", [137, 999, 5003, 1_000_000])
def test_any_cutting_into_packets_gives_the_same_contacts(name: str, length_us: int) -> None:
    whole = EventPacket.concatenate(list(touched()))
    edges = [*range(0, 800 * PERIOD_US, length_us), 800 * PERIOD_US]
    stream = tuple(cut_windows(cut_at(whole, edges), PERIOD_US))
    assert found(build(name), stream) == found(build(name), touched())


@pytest.mark.parametrize(("length_us", "taken"), [(100, 1), (2_000, 0), (5_000, 0)])
def test_windows_of_another_length_are_refused(name: str, length_us: int, taken: int) -> None:
    """One shorter window may be the last of its stream."""
    stream = cut_windows(quiet(), length_us)
    detector = build(name)
    assert found(detector, tuple(islice(stream, taken))) == []
    with pytest.raises(ConfigError, match=f"lasts {length_us} us.*windows of {PERIOD_US} us"):
        detector.update(next(stream))
    with pytest.raises(ConfigError, match="windows of"):
        make_detector(name, DetectionConfig(), [calibration()], [*quiet(), *stream])


def test_two_sensors_make_one_decision(name: str) -> None:
    pairs = tuple(zip(quiet(), windows(3000, seed=4), strict=True))
    detector = make_detector(name, DetectionConfig(), [calibration()] * 2, pairs)
    both = tuple(zip(touched(), windows(800, seed=5, speed=push), strict=True))
    (contact,) = found(detector, both[: TOUCH + 60])
    assert TOUCH * PERIOD_US < contact.t_us <= (TOUCH + 4) * PERIOD_US


def test_a_tighter_budget_raises_the_threshold(name: str) -> None:
    thresholds = []
    for budget in (100.0, 1.0):
        config = DetectionConfig(false_alarms_per_hour=budget)
        detector = make_detector(name, config, [calibration()], quiet())
        thresholds.append(found(detector, touched())[0].threshold)
    assert thresholds[0] < thresholds[1]


def test_too_few_quiet_windows_are_refused(name: str) -> None:
    with pytest.raises(CalibrationError, match=r"50 quiet windows are too few.*moving arm"):
        make_detector(name, DetectionConfig(), [calibration()], islice(quiet(), 50))


def test_the_summary_tells_the_rule_and_the_quiet_windows(name: str) -> None:
    detector = build(name)
    summary = detector.summary()
    assert summary.rule.startswith("a contact is")
    assert summary.quiet == QuietStatistics.of(quiet())
    thresholds = np.ravel(summary.figures.get("thresholds", summary.figures.get("threshold")))
    (contact, *_) = found(detector, touched())
    assert np.isclose(thresholds, contact.threshold, atol=1e-3).any()
    assert json.loads(json.dumps(dict(summary.figures))) == summary.figures


@pytest.mark.parametrize("budget", [0.0, -1.0, 1e9, float("nan"), float("inf")])
def test_a_budget_that_is_no_sound_number_is_refused(budget: float) -> None:
    with pytest.raises(ConfigError, match="valid are 1e-06 to"):
        DetectionConfig(false_alarms_per_hour=budget)


def test_unknown_names_and_missing_calibrations_are_explained() -> None:
    with pytest.raises(ConfigError, match="did you mean 'default'"):
        make_detector("defualt", DetectionConfig(), [calibration()], quiet())
    with pytest.raises(CalibrationError, match="spikingtac calibrate"):
        make_detector("default", DetectionConfig(), [], quiet())
    with pytest.raises(ConfigError, match="hold 2 sensors, the detector was built for 1"):
        build("default").update((touched()[0], touched()[0]))


def test_another_sensor_is_refused_not_indexed() -> None:
    width, height = SIZE
    column = np.array([width + 300], np.uint16)
    for size in ((width + 400, height), SIZE):
        packet = EventPacket(column, column * 0, column > 0, np.array([5]), 0, 1_000, size)
        with pytest.raises(ConfigError, match=r"do not fit|lie outside"):
            build("default").update(packet)
        with pytest.raises(ConfigError, match=r"do not fit|lie outside"):
            make_detector("default", DetectionConfig(), [calibration()], [packet])


def test_what_teaches_nothing_is_refused_in_our_words() -> None:
    known = calibration()
    silent = [EventPacket.empty(k * 1_000, (k + 1) * 1_000, SIZE) for k in range(600)]
    with pytest.raises(CalibrationError):
        make_detector("default", DetectionConfig(), [known], silent)
    twice = np.repeat(known.reference_px[:1], 4, 0)
    for places in (twice, known.reference_px + 9_000.0):  # refused before a detector can be asked
        with pytest.raises(CalibrationError):
            replace(known, reference_px=places, radius_px=known.radius_px[: len(places)], grid=None)
