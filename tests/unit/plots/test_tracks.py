"""Figures of tracks: what is drawn is what was tracked."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from matplotlib.quiver import Quiver
from PIL import Image

from spikingtac.errors import ConfigError
from spikingtac.plots.figure import THEMES, WIDTHS_IN, save_figure
from spikingtac.plots.tracks import ARROW_SHARE, Kind, plot_comparison, plot_tracks
from spikingtac.tracks.comparison import compare_tracks, compare_with_truth
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
    gain = ARROW_SHARE * PITCH_PX / longest_px
    assert axes.get_title() == f"t = 0.250 s, arrows × {gain:.2g}"
    tips = tracks.reference_px + gain * moved
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert (tips > (left, top)).all()
    assert (tips < (right, bottom)).all()


def test_figures_in_mm_have_axes_in_mm() -> None:
    for scale, unit in ((None, "px"), (10.0, "mm")):
        axes = plot_tracks(circling_tracks(estimates=20, px_per_mm=scale), "field").axes[0]
        assert axes.get_xlabel() == f"x ({unit})"
        ticks = [(tick, float(text.get_text())) for tick, text in
                 zip(axes.get_xticks(), axes.get_xticklabels(), strict=True)]  # fmt: skip
        assert all(tick == pytest.approx(label * (scale or 1.0)) for tick, label in ticks)
    figure = circling_tracks(estimates=20, px_per_mm=10.0).plot("course")
    legend = figure.axes[0].get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["each marker", "median", "largest"]


def test_a_comparison_shows_differences_and_errors_of_a_truth() -> None:
    tracks = circling_tracks()
    over_time, by_marker = plot_comparison(compare_tracks(tracks, circling_tracks(off_px=0.5))).axes
    for line in (*over_time.get_lines(), *by_marker.get_lines()):
        np.testing.assert_allclose(np.asarray(line.get_ydata()), 0.5, atol=1e-3)
    assert over_time.get_ylabel() == "difference (px)"
    true = compare_with_truth(tracks, tracks.t_us, tracks.position_px)
    assert plot_comparison(true).axes[1].get_ylabel() == "error (px)"


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
