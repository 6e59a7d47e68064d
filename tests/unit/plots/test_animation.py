"""Animated tracks: what moves is what was tracked, and nothing else changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from spikingtac.errors import ConfigError
from spikingtac.plots.animation import FRAME_MS, save_animation
from stand_ins.tracks import circling_tracks


def pictures(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        frames = []
        for number in range(image.n_frames):
            image.seek(number)
            frames.append(np.asarray(image.convert("L"), float))
    return np.array(frames)


@pytest.mark.parametrize(("theme", "bright"), [("light", True), ("dark", False)])
def test_a_picture_for_every_fiftieth_of_a_second(theme: str, bright: bool, tmp_path: Path) -> None:
    tracks = circling_tracks()
    path = tmp_path / "field.gif"
    count = save_animation(tracks, path, stretch_s=(0.1, 0.4), slow=2.0, theme=theme)
    shown = pictures(path)
    assert count == len(shown) == 1 + round(0.3 * 2.0 * 1_000 / FRAME_MS)
    assert (shown[0].mean() > 128) == bright
    changed = np.abs(np.diff(shown, axis=0)).max(axis=0) > 64
    assert changed.mean() > 0.001  # arrows, the line of the time, and the title
    assert changed[:, : shown.shape[2] // 20].mean() == 0.0  # no label of an axis moves


def test_what_makes_no_sense_is_refused(tmp_path: Path) -> None:
    tracks = circling_tracks(estimates=400)
    with pytest.raises(ConfigError, match=r"from 0\.3 to 0\.2 s: the tracks go from 0 to 0\.399 s"):
        save_animation(tracks, tmp_path / "a.gif", stretch_s=(0.3, 0.2))
    with pytest.raises(ConfigError, match=r"valid endings: \.gif"):
        save_animation(tracks, tmp_path / "a.webp")
    with pytest.raises(ConfigError, match="slow is 0"):
        save_animation(tracks, tmp_path / "a.gif", slow=0.0)
    with pytest.raises(ConfigError, match="600 at most"):
        save_animation(tracks, tmp_path / "a.gif", slow=200.0)
    with pytest.raises(ConfigError, match="does not exist"):
        save_animation(tracks, tmp_path / "none" / "a.gif")
    with pytest.raises(ConfigError, match="nothing to draw"):
        save_animation(circling_tracks(estimates=0), tmp_path / "a.gif")
    assert list(tmp_path.iterdir()) == []
