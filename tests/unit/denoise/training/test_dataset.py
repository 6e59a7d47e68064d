import builtins
import io
import os

import numpy as np
import pytest

from spikingtac.errors import RecordingError
from spikingtac.events.recording import RecordingWriter
from spikingtac.types import EventPacket
from spikingtac_paper.training import dataset
from spikingtac_paper.training.dataset import (
    load_clip,
    make_pairs,
    map_after,
    with_background,
    with_drops,
)
from stand_ins.denoiser_training import SIZE, SPAN_US, moving_disc
from stand_ins.random_packets import rows

MOMENTS = 8


@pytest.fixture
def clean(monkeypatch):
    """Inputs like their targets: nothing is added, dropped or filtered."""
    monkeypatch.setattr(dataset, "NOISE_HZ", (1e-9, 1e-9))
    monkeypatch.setattr(dataset, "DROP", (0.0, 0.0))
    monkeypatch.setattr(dataset, "UNFILTERED_FRACTION", 1.0)
    monkeypatch.setattr(dataset, "TARGET_FILTER_US", 400_000)
    monkeypatch.setattr(dataset, "GRADED_FRACTION", 0.0)


def test_the_loader_never_opens_the_truth(tmp_path, monkeypatch):
    folder = tmp_path / "recording"
    with RecordingWriter(folder, SIZE) as writer:
        writer.write(moving_disc().events)
        writer.truth_file().append({"marker_t_us": np.zeros(1, np.int64)})
    assert (folder / "truth.npz").is_file()
    opened: list[str] = []

    def watch(real):
        def spy(file, *args, **kwargs):
            opened.append(os.fspath(file) if not isinstance(file, int) else "")
            return real(file, *args, **kwargs)

        return spy

    monkeypatch.setattr(builtins, "open", watch(builtins.open))
    monkeypatch.setattr(io, "open", watch(io.open))
    monkeypatch.setattr(np, "load", watch(np.load))
    make_pairs([load_clip(folder)], 2, np.random.default_rng(0))
    assert any(name.endswith("events.raw") for name in opened), "the watch saw nothing"
    assert not any("truth" in name for name in opened)


@pytest.mark.usefixtures("clean")
def test_degradation_reaches_the_input_only(monkeypatch):
    clips = [moving_disc(), moving_disc(1)]
    pairs = make_pairs(clips, MOMENTS, np.random.default_rng(0))
    assert pairs.inputs.shape == (2 * MOMENTS, SIZE[1], SIZE[0])
    assert (pairs.inputs != pairs.targets).mean() < 0.002, "the filter drops first events only"
    assert set(np.unique(pairs.inputs)) == {0, 255}
    monkeypatch.setattr(dataset, "NOISE_HZ", (5.0, 5.0))
    monkeypatch.setattr(dataset, "UNFILTERED_NOISE_HZ", 5.0)
    monkeypatch.setattr(dataset, "DROP", (0.5, 0.5))
    noisy = make_pairs(clips, MOMENTS, np.random.default_rng(0))
    assert (noisy.inputs != noisy.targets).mean(axis=(1, 2))[-1] > 0.05
    assert set(np.unique(noisy.targets)) == set(np.unique(pairs.targets))


def test_the_map_after_slides_is_where_others_begin():
    clip = moving_disc()
    after = map_after(clip)
    assert set(np.unique(after)) == {0.0, 1.0}
    assert after.sum() == pytest.approx(clip.start.sum(), rel=0.2)
    assert not np.array_equal(after, clip.start)


def test_an_empty_recording_is_refused(tmp_path):
    with RecordingWriter(tmp_path / "silent", SIZE) as writer:
        writer.write(EventPacket.empty(0, SPAN_US, SIZE))
    with pytest.raises(RecordingError, match="no events to train on"):
        load_clip(tmp_path / "silent")


def test_background_has_its_rate_and_both_signs_alike():
    noisy = with_background(EventPacket.empty(0, 4_000_000, SIZE), 5.0, np.random.default_rng(1))
    expected = 5.0 * SIZE[0] * SIZE[1] * 4
    assert len(noisy) == pytest.approx(expected, abs=4 * expected**0.5)
    assert noisy.p.mean() == pytest.approx(0.5, abs=0.01)
    assert noisy.x.max() == SIZE[0] - 1
    assert noisy.y.max() == SIZE[1] - 1


def test_background_keeps_every_event_and_the_invariants():
    events = moving_disc().events
    noisy = with_background(events, 3.0, np.random.default_rng(1))
    noisy.sound()
    assert (np.diff(noisy.t) >= 0).all()
    assert noisy.t_start_us <= noisy.t[0] <= noisy.t[-1] < noisy.t_end_us
    assert {*rows(noisy)} >= {*rows(events)}


def test_drops_have_their_share():
    many = with_background(EventPacket.empty(0, SPAN_US, SIZE), 50.0, np.random.default_rng(1))
    kept = with_drops(many, 0.3, np.random.default_rng(2))
    assert len(kept) / len(many) == pytest.approx(0.7, abs=0.01)
