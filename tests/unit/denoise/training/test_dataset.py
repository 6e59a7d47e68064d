import builtins
import dataclasses
import io
import os
from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events.recording import RecordingWriter
from spikingtac.types import EventPacket
from spikingtac_paper.training.dataset import PairConfig, load_clip, make_pairs, map_after
from stand_ins.denoiser_training import SIZE, SPAN_US, moving_disc

NO_DEGRADATION = PairConfig(
    noise_hz=(1e-9, 1e-9),
    drop=(0.0, 0.0),
    unfiltered_fraction=1.0,
    target_filter_us=0,
    graded_fraction=0.0,
)


def write_recording(folder: Path, *, truth: bool) -> Path:
    clip = moving_disc()
    with RecordingWriter(folder, SIZE) as writer:
        writer.write(clip.events)
        if truth:
            writer.append_truth({"marker_t_us": np.zeros(1, np.int64)})
    return folder


def test_the_loader_never_opens_the_truth(tmp_path, monkeypatch):
    folder = write_recording(tmp_path / "recording", truth=True)
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
    make_pairs([clip], PairConfig(moments=2), np.random.default_rng(0))
    assert any(name.endswith("events.raw") for name in opened), "the watch saw nothing"
    assert not any("truth" in name for name in opened)


def test_truth_or_not_the_clip_is_the_same(tmp_path):
    with_truth = load_clip(write_recording(tmp_path / "a", truth=True))
    without = load_clip(write_recording(tmp_path / "b", truth=False))
    assert not (tmp_path / "b" / "truth.npz").exists()
    for column in ("t", "x", "y", "p"):
        assert np.array_equal(getattr(with_truth.events, column), getattr(without.events, column))


def test_a_truth_that_is_rubbish_does_no_harm(tmp_path):
    folder = write_recording(tmp_path / "recording", truth=False)
    (folder / "truth.npz").write_bytes(b"not an archive")
    assert len(load_clip(folder).events) == len(moving_disc().events)


def test_an_undegraded_input_equals_its_target():
    clip = moving_disc()
    pairs = make_pairs([clip, moving_disc(1)], NO_DEGRADATION, np.random.default_rng(0))
    assert pairs.inputs.shape == (2 * NO_DEGRADATION.moments, SIZE[1], SIZE[0])
    assert np.array_equal(pairs.inputs, pairs.targets)
    assert set(np.unique(pairs.inputs)) == {0, 255}


def test_degradation_reaches_the_input_only():
    config = dataclasses.replace(
        NO_DEGRADATION, noise_hz=(5.0, 5.0), unfiltered_noise_hz=5.0, drop=(0.5, 0.5)
    )
    clean = make_pairs([moving_disc()], NO_DEGRADATION, np.random.default_rng(0))
    noisy = make_pairs([moving_disc()], config, np.random.default_rng(0))
    changed = (noisy.inputs != noisy.targets).mean(axis=(1, 2))
    assert changed[-1] > 0.05
    assert set(np.unique(noisy.targets)) == set(np.unique(clean.targets))


def test_the_same_seed_gives_the_same_pairs():
    one, other = (
        make_pairs([moving_disc()], PairConfig(), np.random.default_rng(7)) for _ in range(2)
    )
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
    folder = write_recording(tmp_path / "recording", truth=False)
    with pytest.raises(ConfigError, match=r"\(4, 4\).*\(48, 64\)"):
        load_clip(folder, np.zeros((4, 4), np.float32))


@pytest.mark.parametrize(
    "wrong",
    [
        {"noise_hz": (0.0, 1.0)},
        {"noise_hz": (2.0, 1.0)},
        {"drop": (0.5, 1.0)},
        {"graded_fraction": 1.5},
        {"moments": 0},
    ],
)
def test_unfit_settings_are_refused(wrong):
    with pytest.raises(ValueError, match=r"must|valid|ranges|shares"):
        PairConfig(**wrong)
