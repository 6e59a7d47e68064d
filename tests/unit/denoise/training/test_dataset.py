import builtins
import io
import os
from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events.recording import RecordingWriter
from spikingtac.types import EventPacket
from spikingtac_paper.training import dataset
from spikingtac_paper.training.dataset import load_clip, make_pairs, map_after
from stand_ins.denoiser_training import SIZE, SPAN_US, moving_disc

MOMENTS = 8


@pytest.fixture
def clean(monkeypatch):
    """Inputs like their targets: nothing is added, dropped or filtered."""
    for name, value in {
        "NOISE_HZ": (1e-9, 1e-9),
        "DROP": (0.0, 0.0),
        "UNFILTERED_FRACTION": 1.0,
        "TARGET_FILTER_US": 400_000,
        "GRADED_FRACTION": 0.0,
    }.items():
        monkeypatch.setattr(dataset, name, value)


def write_recording(folder: Path) -> Path:
    with RecordingWriter(folder, SIZE) as writer:
        writer.write(moving_disc().events)
        writer.append_truth({"marker_t_us": np.zeros(1, np.int64)})
    return folder


def test_the_loader_never_opens_the_truth(tmp_path, monkeypatch):
    folder = write_recording(tmp_path / "recording")
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
    clip = load_clip(folder)
    make_pairs([clip], 2, np.random.default_rng(0))
    assert any(name.endswith("events.raw") for name in opened), "the watch saw nothing"
    assert not any("truth" in name for name in opened)


@pytest.mark.usefixtures("clean")
def test_degradation_reaches_the_input_only(monkeypatch):
    clips = [moving_disc(), moving_disc(1)]
    pairs = make_pairs(clips, MOMENTS, np.random.default_rng(0))
    assert pairs.inputs.shape == (2 * MOMENTS, SIZE[1], SIZE[0])
    assert (pairs.inputs != pairs.targets).mean() < 0.002, "the filter drops first events only"
    assert set(np.unique(pairs.inputs)) == {0, 255}
    for name, value in (
        ("NOISE_HZ", (5.0, 5.0)),
        ("UNFILTERED_NOISE_HZ", 5.0),
        ("DROP", (0.5, 0.5)),
    ):
        monkeypatch.setattr(dataset, name, value)
    noisy = make_pairs(clips, MOMENTS, np.random.default_rng(0))
    assert (noisy.inputs != noisy.targets).mean(axis=(1, 2))[-1] > 0.05
    assert set(np.unique(noisy.targets)) == set(np.unique(pairs.targets))


def test_the_same_seed_gives_the_same_pairs():
    one, other = (make_pairs([moving_disc()], MOMENTS, np.random.default_rng(7)) for _ in range(2))
    assert np.array_equal(one.inputs, other.inputs)
    assert np.array_equal(one.targets, other.targets)


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


def test_a_start_of_another_size_names_both_shapes(tmp_path):
    folder = write_recording(tmp_path / "recording")
    with pytest.raises(ConfigError, match=r"\(4, 4\).*\(48, 64\)"):
        load_clip(folder, np.zeros((4, 4), np.float32))
