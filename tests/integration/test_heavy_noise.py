"""At 5 Hz/px of background the whole pipeline keeps every marker of the twin."""

import numpy as np
import pytest

from spikingtac.config import load_config
from spikingtac.markers.neighbours import smallest_spacing_px
from spikingtac.markers.registry import make_tracker
from spikingtac.pipeline.follow import follow
from spikingtac.tracks import Tracks
from spikingtac_paper.denoise import render
from spikingtac_paper.training.dataset import with_background
from stand_ins.known import known

NOISE_HZ = 5.0
DURATION_S = 3.0
RATE_HZ = 350.0  # The paper's.


@pytest.fixture(scope="module")
def recording():
    return render("spoon-circles", 1001, DURATION_S)


def errors_px(recording, config) -> tuple[np.ndarray, np.ndarray]:
    events = with_background(recording.events, NOISE_HZ, np.random.default_rng(0))
    truth = recording.truth
    sensor = known(truth.reference_px, truth.radius_px)
    found = Tracks.of(follow([events], make_tracker(config.tracking, sensor), RATE_HZ), sensor)
    return np.linalg.norm(found.detected_px - recording.truth.at(found.t_us), axis=2), found.coasted


@pytest.mark.parametrize("preset", ["default", "paper"])
def test_no_marker_is_lost_at_five_hertz_a_pixel(recording, preset):
    moved = np.ptp(recording.truth.marker_px, axis=0).max()
    assert moved > 2.0, "markers that rest cannot be lost"
    error_px, held = errors_px(recording, load_config(preset))
    assert error_px.shape[1] == 64
    assert not held.any()
    assert error_px.max() < 0.5 * smallest_spacing_px(recording.truth.reference_px)
    assert error_px.mean() < 0.5
