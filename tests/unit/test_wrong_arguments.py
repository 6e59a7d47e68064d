"""Who passes a name or a path where the thing itself is expected is told how to make it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import spikingtac as st
from stand_ins.known import known
from stand_ins.moving_rims import GRID
from stand_ins.tracks import circling_tracks

TRACKS = circling_tracks(estimates=2)
CONFIG, CALIBRATION = st.load_config("fast"), known(GRID)
TRACKER = st.make_tracker(CONFIG.tracking, CALIBRATION)
LARGE = CALIBRATION.radius_px + 83.5
EVENTS = r"EventSource, given .*'a\.raw'.*; make one: spikingtac\.open_events"


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (
            lambda: st.make_tracker("fast", CALIBRATION),  # type: ignore[arg-type]
            r"TrackingConfig, given 'fast'; make one: spikingtac\.load_config\(.*\)\.tracking",
        ),
        (
            lambda: st.make_tracker(CONFIG.tracking, Path("a.json")),
            r"Calibration, given PosixPath\('a\.json'\); make one: spikingtac\.Calibration\.load",
        ),
        (
            lambda: st.make_tracker(CONFIG.tracking, replace(CALIBRATION, radius_px=LARGE)),
            "radius is 90.5 px; discs of at most 90 px",
        ),
        (lambda: st.CalibrationConfig(method="bounding_box"), "did you mean 'bounding-box'"),
        (lambda: st.CalibrationConfig(layout="hexagonal"), "layout: 'hexagonal' is not valid"),
        (lambda: st.CalibrationConfig(polarity="whte"), "did you mean 'white'.*valid: auto, white"),
        (lambda: st.Calibration.load(3), r"given int; make one: spikingtac\.Calibration\.load"),  # type: ignore[arg-type]
        (lambda: st.load_force(3), "the path of a file, given int; .*load_force"),  # type: ignore[arg-type]
        (lambda: st.CalibrationConfig(grid="8x8"), "grid: expected a list, got '8x8'"),
        (lambda: st.CalibrationConfig(grid=(8, 8, 8)), "grid: expected 2 values, got 3"),
        (lambda: st.CalibrationConfig(pitch_mm="2.4"), "pitch_mm: expected float, got '2.4'"),
        (lambda: st.simulate("demo", "out"), r"Scene, given 'demo'; .*load_scene\('demo'\)"),
        (lambda: st.plot_tracks("a.npz"), r"Tracks, given 'a\.npz'; .*Tracks\.load"),
        (lambda: st.compare_tracks(circling_tracks(), "a.npz"), r"Tracks, given 'a\.npz'"),
        (lambda: st.compare_with_truth("a.npz", [], []), r"Tracks, given 'a\.npz'"),
        (lambda: st.compare_with_truth(TRACKS, [0, 1], [[1.0, 2.0]]), r"are \(1, 2\), needed are"),
        (lambda: st.make_detector("default", CONFIG, [], []), "DetectionConfig, given Config;"),  # type: ignore[arg-type]
        (lambda: st.make_detector("default", CONFIG.contact, CALIBRATION, []), "in a list"),  # type: ignore[arg-type]
        (lambda: st.make_detector(None, CONFIG.contact, [], []), "contact detector None"),  # type: ignore[arg-type]
        (lambda: list(st.follow([], "default", 9.0)), "MarkerTracker, given 'default'"),  # type: ignore[arg-type]
        (lambda: st.calibrate([], (8, 8)), "CalibrationConfig, given tuple"),  # type: ignore[arg-type]
        (lambda: st.Tracks.load(None), r"a file, given NoneType; .*Tracks\.load"),  # type: ignore[arg-type]
        (lambda: st.open_events(None), "a file, given NoneType; .*open_events"),  # type: ignore[arg-type]
        (lambda: st.open_events(__file__, size="9x9"), "size: expected a list, got '9x9'"),  # type: ignore[arg-type]
        (lambda: st.open_arm(None), "no arm None"),  # type: ignore[arg-type]
        (lambda: st.calibrate(Path("a.raw")), EVENTS),
        (lambda: list(st.windows("a.raw", 1_000)), EVENTS),
        (lambda: list(st.windows([1], 1_000)), r"EventPacket, given int"),  # type: ignore[list-item]
        (lambda: list(st.windows([], 1e3)), r"period_us is 1000\.0, it must be a whole"),  # type: ignore[arg-type]
        (lambda: st.find_touches("a.npz"), r"Tracks, given 'a\.npz'"),  # type: ignore[arg-type]
        (lambda: st.fit_force("a.npz"), r"WrenchSeries, given 'a\.npz'; .*touch\.load_series"),  # type: ignore[arg-type]
        (lambda: st.fit_force([None]), "WrenchSeries, given NoneType"),  # type: ignore[list-item]
        (lambda: st.live("udp:0", calibration=CALIBRATION, rate_hz=-1), "rate_hz is -1, it must"),
        (lambda: st.track(CALIBRATION.reference_px, CALIBRATION), "given ndarray; .*open_events"),  # type: ignore[arg-type]
        (lambda: st.track([], CALIBRATION, rate_hz="fast"), "rate_hz is 'fast', it must"),  # type: ignore[arg-type]
        (lambda: st.track([Path("a.raw")], CALIBRATION), "EventSource, given list"),  # type: ignore[list-item]
        (lambda: st.calibrate({"t": [1]}), "EventSource, given dict"),  # type: ignore[arg-type]
        (lambda: st.CalibrationConfig(grid=(8, 1_000)), "valid are 1 to 256 rows, columns"),
        (lambda: list(st.follow("a.raw", TRACKER, 9.0)), EVENTS),
    ],
)
def test_it_is_refused(
    call: Callable[[], Any], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(st.SpikingTacError, match=told):
        call()
    assert list(tmp_path.iterdir()) == []
