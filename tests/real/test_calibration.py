"""Calibration without options: recordings of real gels, and simulated ones of the same kind."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.errors import CalibrationError
from spikingtac.events.open import open_events
from spikingtac.events.source import EventSource, PacketSource
from spikingtac.markers.calibration.calibrate import calibrate
from spikingtac.markers.registry import make_tracker
from spikingtac.pipeline.follow import follow
from spikingtac.tracks import Tracks
from spikingtac.types import EventPacket
from spikingtac_paper.real_gels import truth_scores
from spikingtac_paper.trials.trajectories import GroundTruth, Prediction
from stand_ins.made_once import made_once
from stand_ins.verbs import Verbs

DEFAULT = load_config("default").tracking
CORNER_PX = (138, 144)  # Two borders of the sensor, and four by four of its five by seven markers.

GEL_CORNER_PX = (160, 160)  # Four by four of the eight by eight markers of v2e's gel.


@cache
def calibrated(path: Path, size: tuple[int, int] | None = None) -> Calibration:
    """Return what a recording, or its corner, teaches, without its lag.

    Skips the test where there is no recording.
    """

    def make() -> Calibration:
        return calibrate(corner(path, size) if size else recording(path), estimate_lag=False)

    return made_once(f"calibrated_{path.parent.name}_{path.name}_{size}", make)


def recording(path: Path) -> EventSource:
    """Open a recording; skips the test where there is none."""
    if not path.is_file():
        pytest.skip(f"{path.name} is not among the test recordings")
    return open_events(path)


def corner(path: Path, size: tuple[int, int]) -> PacketSource:
    """Return the upper left ``(width, height)`` of a recording, as if the sensor were so small."""
    return PacketSource(list(_cut(recording(path), size)), size)


def _cut(source: EventSource, size: tuple[int, int]) -> Iterator[EventPacket]:
    for packet in source:
        inside = packet.select((packet.x < size[0]) & (packet.y < size[1]))
        yield replace(inside, size=size)


def tracked(
    recording: Path, size: tuple[int, int], known: Calibration, rate_hz: float = 500.0
) -> dict[str, float]:
    """Track the corner of a recording by the preset ``default``; return its scores."""
    frames = follow(corner(recording, size), make_tracker(DEFAULT, known), rate_hz)
    prediction = Prediction.collect(frames, known.reference_px, every=1)
    scores = truth_scores(prediction, GroundTruth.load(recording.with_suffix(".truth.npz")), known)
    print(recording.name, {name: round(value, 3) for name, value in scores.items()})
    return scores


def test_a_simulated_sensor_with_rare_off_events_from_its_presses_alone(data_dir: Path) -> None:
    found = calibrated(data_dir / "gel" / "sim_presses.raw", CORNER_PX)
    places = np.load(data_dir / "gel" / "sim_presses.truth.npz")["reference_px"]
    error_px = np.hypot(*(found.reference_px - places[(places < CORNER_PX).all(axis=1)]).T)
    assert (found.grid, found.polarity) == ((4, 4), "white")
    assert np.asarray(found.marker_measured).all()
    assert error_px.mean() < 0.12
    assert error_px.max() < 0.25
    assert found.step_off == pytest.approx(0.42 / 0.15 * (found.step_on or 0.0), rel=0.05)


@pytest.mark.parametrize(
    ("calibrated_from", "mean_px", "p95_px"),
    [("sim_presses.raw", 0.25, 0.65), ("sim_presses_bootstrap.raw", 0.25, 0.6)],
)
def test_rare_off_events_are_tracked(
    data_dir: Path, calibrated_from: str, mean_px: float, p95_px: float
) -> None:
    known = calibrated(data_dir / "gel" / calibrated_from, CORNER_PX)
    scores = tracked(data_dir / "gel" / "sim_presses.raw", CORNER_PX, known)
    assert scores["error_mean_px"] < mean_px
    assert scores["error_p95_px"] < p95_px
    assert scores["error_max_px"] < 5.0, "none is lost"


def test_a_flawed_gel_with_pale_markers_is_tracked(data_dir: Path) -> None:
    known = calibrate(corner(data_dir / "gel" / "gel_bootstrap.raw", GEL_CORNER_PX))  # and its lag
    scores = tracked(data_dir / "gel" / "gel.raw", GEL_CORNER_PX, known, 1_000.0)
    assert known.grid == (4, 4)
    assert scores["error_mean_px"] < 0.15
    assert scores["error_p95_px"] < 0.36, "0.35 over the whole sensor, whose corners are soft"
    assert scores["error_max_px"] < 5.0, "none is lost"


@pytest.mark.slow
def test_a_gel_calibrated_from_its_own_motion_loses_no_pale_marker(data_dir: Path) -> None:
    """Two of its 64 hardly move: their places are guessed, but their events tell their steps."""
    path = data_dir / "gel" / "gel.raw"
    known = calibrate(open_events(path))
    guessed = ~np.asarray(known.marker_measured)
    assert np.count_nonzero(guessed) == 2
    assert np.asarray(known.marker_step_on)[guessed].min() > 1.3 * float(known.step_on or 1.0)
    scores = tracked(path, known.size, known)
    assert scores["error_mean_px"] < 0.19
    assert scores["lost_markers"] == 0


def test_a_real_sensor_has_one_marker_that_never_moves(data_dir: Path) -> None:
    found = calibrated(data_dir / "gel" / "real_presses.aedat4")
    assert (found.grid, found.polarity) == ((5, 7), "white")
    assert np.flatnonzero(~np.asarray(found.marker_measured)).tolist() == [17], "row 3, column 4"


def test_a_marker_that_falls_silent_rests_where_it_was(data_dir: Path) -> None:
    path = data_dir / "layouts" / "mute.raw"
    places_px = np.load(path.with_suffix(".truth.npz"))["reference_px"]
    assert np.abs(calibrate(open_events(path)).reference_px - places_px).max() < 0.15


def test_a_recording_twice_as_long_is_calibrated_as_well(data_dir: Path) -> None:
    recorded = corner(data_dir / "gel" / "real_presses.aedat4", CORNER_PX)
    once = EventPacket.concatenate(list(recorded))
    # Some events are left out, so that the second half is another recording.
    kept = np.random.default_rng(3).random(len(once)) < 0.97
    start_us, end_us = once.t_start_us, once.t_end_us
    later_us = end_us - start_us
    again = EventPacket(
        once.x[kept], once.y[kept], once.p[kept], once.t[kept] + later_us,
        end_us, end_us + later_us, once.size,
    )  # fmt: skip
    found = calibrate(PacketSource([once, again], once.size), estimate_lag=False)
    assert found.grid == (4, 4)
    assert found.marker_measured is not None
    assert np.flatnonzero(~found.marker_measured).tolist() == [11], "row 3, column 4 never moves"


@pytest.mark.parametrize(
    "name",
    [
        "evt2_rotating_dot.raw",
        "evt3_busy_scene.raw",
        "ros1_evt3_events.bag",
        "ros2_evt3_events.db3",
    ],
)
def test_what_is_no_marker_sensor_is_refused(data_dir: Path, name: str) -> None:
    with pytest.raises(CalibrationError, match="no grid of markers"):
        calibrated(data_dir / "real" / name)


def test_the_four_recorded_presses_are_the_contacts_and_the_touches(
    data_dir: Path, tmp_path: Path, verbs: Verbs
) -> None:
    recording, tracks = data_dir / "gel" / "real_presses.aedat4", tmp_path / "tracks.npz"
    given = recording, "--calibration", tmp_path / "calibration.json"
    calibrated(recording).save(given[-1])
    verbs.said("track", *given, "-o", tracks)
    touches = verbs.told("touch", tracks, "-o", tmp_path / "touches.csv")["touches"]
    contacts = verbs.told("contact", *given)["contacts"]  # no OFF event on a rim before the first
    times_us = [*(one["begin_us"] for one in touches), *(one["t_us"] for one in contacts)]
    times_us += [one["end_us"] for one in (*touches, *contacts)]
    begins_us, ends_us = np.reshape(times_us, (2, 2, 4))
    with np.load(data_dir / "gel" / "real_presses.reference.npz") as known:
        bursts_us = known["burst_us"] + int(Tracks.load(tracks).t_us[0])
    assert np.abs(begins_us - bursts_us[::2, 0]).max() < 100_000
    assert (ends_us > bursts_us[1::2, 0] - 100_000).all()
    assert (ends_us < bursts_us[1::2, 1] + 100_000).all()
