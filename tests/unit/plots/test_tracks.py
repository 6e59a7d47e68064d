"""Figures of tracks: what is drawn is what was tracked."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from matplotlib.quiver import Quiver
from PIL import Image

from spikingtac.errors import ConfigError
from spikingtac.plots.comparison import plot_comparison
from spikingtac.plots.theme import THEMES, WIDTHS_IN
from spikingtac.plots.tracks import ARROW_SHARE, Kind, plot_tracks, save_figure
from spikingtac.tracks.comparison import compare_tracks
from stand_ins.tracks import circling_tracks
from stand_ins.viewer import PITCH_PX


@pytest.mark.parametrize("kind", get_args(Kind))
@pytest.mark.parametrize("theme", THEMES)
def test_every_kind_is_drawn_in_every_theme(kind: str, theme: str, tmp_path: Path) -> None:
    figure = plot_tracks(circling_tracks(estimates=20), kind, theme=theme)
    save_figure(figure, tmp_path / "figure.png")
    image = np.asarray(Image.open(tmp_path / "figure.png").convert("L"), float)
    assert image.shape[1] == pytest.approx(300 * WIDTHS_IN["single"], abs=2)
    assert image.std() > 5.0
    assert (image.mean() > 128) == (theme == "light")


def test_the_course_is_the_length_of_the_displacement() -> None:
    tracks = circling_tracks(px_per_mm=2.0)
    axes = plot_tracks(tracks, "course").axes[0]
    lines = [np.asarray(line.get_ydata()) for line in axes.get_lines()]
    length_mm = np.hypot(*np.moveaxis(tracks.displacement_px, 2, 0)) / 2.0
    np.testing.assert_allclose(np.array(lines[:64]), length_mm.T, rtol=1e-5)
    np.testing.assert_allclose(lines[-1], length_mm.max(axis=1), rtol=1e-5)
    assert axes.get_ylabel() == "displacement (mm)"


def test_arrows_point_where_the_markers_went() -> None:
    tracks = circling_tracks()
    axes = plot_tracks(tracks, "field", at_us=250_007).axes[0]
    arrows = next(item for item in axes.collections if isinstance(item, Quiver))
    moved = tracks.displacement_px[250]
    drawn = np.column_stack([np.asarray(arrows.U), np.asarray(arrows.V)])
    longest_px = np.hypot(*moved.T).max()
    np.testing.assert_allclose(drawn, moved * ARROW_SHARE * PITCH_PX / longest_px, rtol=1e-5)
    np.testing.assert_allclose(arrows.XY, tracks.reference_px)
    assert axes.get_title() == "t = 0.250 s"


def test_wrong_names_and_empty_tracks_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="did you mean 'field'"):
        plot_tracks(circling_tracks(estimates=2), "fild")
    with pytest.raises(ConfigError, match="nothing to draw"):
        plot_tracks(circling_tracks(estimates=0))
    figure = plot_tracks(circling_tracks(estimates=2))
    with pytest.raises(ConfigError, match=r"\.png, \.svg, \.pdf"):
        save_figure(figure, tmp_path / "figure.jpg")
    with pytest.raises(ConfigError, match="does not exist"):
        save_figure(figure, tmp_path / "no" / "figure.png")


def test_a_comparison_is_drawn_over_time_and_by_marker() -> None:
    found = compare_tracks(circling_tracks(), circling_tracks(off_px=0.5))
    over_time, by_marker = plot_comparison(found).axes
    for line in (*over_time.get_lines(), *by_marker.get_lines()):
        np.testing.assert_allclose(np.asarray(line.get_ydata()), 0.5, atol=1e-3)
    assert len(np.asarray(by_marker.get_lines()[0].get_ydata())) == 64
