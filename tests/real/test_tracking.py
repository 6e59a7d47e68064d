"""Recordings in, displacements out: calibrate on one v2e recording, track another, against truth.

v2e is an independent simulator, so that nothing here was made by the project's own twin. The bounds
are what the project promises of such recordings, not what it happens to reach.
"""

from collections.abc import Iterable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.denoise.classical import Box7, Denoiser, Median3
from spikingtac.events.open import open_events
from spikingtac.events.windows import windows
from spikingtac.markers.blobs import find_blobs
from spikingtac.markers.calibration.calibrate import calibrate
from spikingtac.markers.paper import PAPER_RATE_HZ, BlobTracker, BlobTrackerConfig
from spikingtac.markers.registry import MarkerTracker, make_tracker
from spikingtac.pipeline.follow import follow
from spikingtac.state_map.binary import BinaryStateMap
from spikingtac.state_map.graded import GradedStateMap
from spikingtac.tracks import Tracks
from spikingtac.types import EventPacket
from spikingtac_paper.trials.metrics import LOST_US, SUCCESS_PX, longest_duration_us
from spikingtac_paper.trials.trajectories import GroundTruth
from stand_ins.known import known

RATE_HZ = 1_000.0


@cache
def calibration(folder: Path) -> Calibration:
    return calibrate(open_events(folder / "bootstrap.raw"))


def tracker_of(folder: Path, preset: str) -> MarkerTracker:
    return make_tracker(load_config(preset).tracking, calibration(folder))


class Outcome:
    """How a tracker did on mix.raw."""

    def __init__(
        self, folder: Path, tracker: MarkerTracker, packets: Iterable[EventPacket], rate_hz: float
    ) -> None:
        found = Tracks.of(follow(packets, tracker, rate_hz), calibration(folder))
        self.t_us, self.detected_px, self.coasted = found.t_us, found.detected_px, found.coasted
        self.truth_px = GroundTruth.load(folder / "mix.truth.npz").at(found.t_us)
        self.error_px = np.linalg.norm(self.detected_px - self.truth_px, axis=2)
        self.mean_px = float(self.error_px.mean())
        self.p95_px = float(np.percentile(self.error_px, 95))
        print(f"mean {self.mean_px:.3f} px, p95 {self.p95_px:.3f} px (v2e, simulated)")

    def lost(self) -> int:
        away_us = longest_duration_us(self.error_px > SUCCESS_PX, self.t_us)
        return int((away_us > LOST_US).sum())

    def swaps(self) -> int:
        nearest = np.linalg.norm(self.detected_px[-1][:, None] - self.truth_px[-1][None], axis=2)
        return int((nearest.argmin(axis=1) != np.arange(len(nearest))).sum())


def test_calibration_from_an_empty_map(data_dir: Path) -> None:
    folder = data_dir / "v2e"
    truth = np.load(folder / "bootstrap.truth.npz")
    found = calibration(folder)
    error_px = np.linalg.norm(found.reference_px - truth["reference_px"], axis=1)
    print(f"reference: mean {error_px.mean():.3f} px, worst {error_px.max():.3f} px (v2e)")
    assert found.grid == (8, 8)
    assert error_px.mean() < 0.10
    assert error_px.max() < 0.30
    assert np.abs(found.radius_px - truth["radius_px"]).mean() < 0.25
    assert found.lag_us == pytest.approx(2_600.0, rel=0.25), "best constant lag on this sensor"


@pytest.mark.parametrize(
    ("preset", "mean_px", "p95_px"), [("default", 0.115, 0.28), ("fast", 0.13, 0.30)]
)
def test_mix_is_tracked(data_dir: Path, preset: str, mean_px: float, p95_px: float) -> None:
    folder = data_dir / "v2e"
    outcome = Outcome(folder, tracker_of(folder, preset), open_events(folder / "mix.raw"), RATE_HZ)
    assert outcome.mean_px < mean_px
    assert outcome.p95_px < p95_px
    assert outcome.lost() == 0
    assert outcome.swaps() == 0
    assert not outcome.coasted.any()


def test_a_third_of_the_events_may_be_lost(data_dir: Path) -> None:
    folder = data_dir / "v2e"
    rng, whole = np.random.default_rng(11), open_events(folder / "mix.raw")
    kept = (packet.select(rng.random(len(packet)) >= 0.3) for packet in whole)
    outcome = Outcome(folder, tracker_of(folder, "default"), kept, RATE_HZ)
    assert outcome.mean_px < 0.165
    assert outcome.lost() == 0
    assert outcome.swaps() == 0


@pytest.mark.parametrize("denoiser", [Median3(), Box7()], ids=["median3", "box7"])
def test_the_published_front_end_has_its_bias(data_dir: Path, denoiser: Denoiser) -> None:
    """It runs as the paper's does, about a pixel behind the truth in motion."""
    folder = data_dir / "v2e"
    truth = dict(np.load(folder / "bootstrap.truth.npz"))
    rest = known(truth["reference_px"], truth["radius_px"])
    tracker = BlobTracker(BlobTrackerConfig(support_us=0, refresh_us=0), rest, denoiser)
    outcome = Outcome(folder, tracker, open_events(folder / "mix.raw"), PAPER_RATE_HZ)
    assert outcome.error_px.shape[1] == 64
    assert 0.7 < outcome.mean_px < 1.25, "the bias of the last-polarity map: neither gone nor grown"
    assert outcome.p95_px < 2.0
    assert np.median(outcome.error_px[-PAPER_RATE_HZ:], axis=0).max() < 5.0, "no marker is lost"
    assert outcome.coasted.mean() < 0.001


@pytest.mark.parametrize("graded", [False, True])
def test_the_rotating_dot_is_found_in_every_window(data_dir: Path, graded: bool) -> None:
    """A real sensor, a real dot that moves 13 px per ms: it is whole after three to four windows.

    It is dark, so polarities swap. The graded map begins empty with a nominal step.
    """
    source = open_events(data_dir / "real" / "evt2_rotating_dot.raw")
    empty = np.zeros(source.size[::-1], np.float32)
    state_map = (
        GradedStateMap(empty, 0.3, 0.3, dark_markers=True)
        if graded
        else BinaryStateMap(source.size, dark_markers=True)
    )
    centers = []
    for index, window in enumerate(windows(source, 1_000)):
        state_map.absorb(window)
        level = state_map.values if graded else Median3().clean(state_map.values)
        blobs = find_blobs(level, areas_px=(200.0, 2_000.0))
        if index >= 5:
            assert len(blobs.area_px) == 1, f"window {index}"
            centers.append(blobs.center_px[0])
    points = np.array(centers)
    design = np.column_stack([2.0 * points, np.ones(len(points))])
    solved, *_ = np.linalg.lstsq(design, (points**2).sum(axis=1), rcond=None)
    orbit_px = np.sqrt(solved[2] + solved[:2] @ solved[:2])
    rms_px = np.sqrt(np.mean((np.hypot(*(points - solved[:2]).T) - orbit_px) ** 2))
    print(f"dot: centre {solved[:2].round(2)}, orbit {orbit_px:.2f} px, rms {rms_px:.2f} px (real)")
    assert len(points) >= 44
    assert np.hypot(*(solved[:2] - [314.3, 202.3])) < 1.0
    assert orbit_px == pytest.approx(107.0, abs=1.0)
    assert rms_px < 0.6
