"""Figures: what is drawn of tracks, events and holes is what was measured."""

import re
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.quiver import Quiver
from PIL import Image, ImageSequence

from spikingtac.errors import ConfigError
from spikingtac.events import hot_pixels_of, open_events
from spikingtac.geometry.hole import Circle
from spikingtac.plots.circles import PLANE_REGION, HolePicture, draw_hole
from spikingtac.plots.events import RATE_US, SURFACE_US, event_figures, plot_events
from spikingtac.plots.figure import THEMES, WIDTHS_IN, save_figure
from spikingtac.plots.moments import FRAME_MS, save_animation
from spikingtac.plots.tracks import ARROW_SHARE, Kind, plot_comparison, plot_tracks
from spikingtac.tracks.comparison import compare_tracks, compare_with_truth
from stand_ins.random_packets import packet_of, save_events
from stand_ins.source_trees import PACKAGE
from stand_ins.tracks import circling_tracks
from stand_ins.viewer import PITCH_PX

SIZE = (32, 24)
HOT = (5, 7)
RADIUS_MM = 2.0
RESIDUAL_MM = np.array([0.02, -0.01, 0.0, 0.015])
ANGLE_RAD = np.radians([10.0, 100.0, 190.0, 280.0])


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
    legend = circling_tracks(estimates=20, px_per_mm=10.0).plot("course").axes[0].get_legend()
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


def pictures(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        frames = ImageSequence.Iterator(image)
        return np.array([np.asarray(frame.convert("L"), float) for frame in frames])


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
    for given, why in (
        ({"stretch_s": (0.3, 0.2)}, r"from 0\.3 to 0\.2 s: the tracks go from 0 to 0\.399 s"),
        ({"slow": 0.0}, "slow is 0"),
        ({"slow": 200.0}, "600 at most"),
    ):
        with pytest.raises(ConfigError, match=why):
            save_animation(tracks, tmp_path / "a.gif", **given)
    with pytest.raises(ConfigError, match=r"valid endings: \.gif"):
        save_animation(tracks, tmp_path / "a.webp")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """A hot pixel at 1 kHz for 2 s, and a burst of 100 ON events of one column at 1.0 s."""
    hot = np.array([(t_us, *HOT, 0) for t_us in range(0, 2_000_000, 1_000)])
    burst = np.array([(1_000_500, 20, k % 20, 1) for k in range(100)])
    columns = np.concatenate([hot[:1_001], burst, hot[1_001:]]).T
    return save_events(tmp_path / "a.raw", packet_of(*columns, SIZE, (0, 2_000_000)))


def test_the_busiest_moment_the_surface_and_the_hot_pixel_are_found(recorded: Path) -> None:
    for chunk in (50, 100_000):
        found = event_figures(open_events(recorded, chunk_events=chunk))
        assert found.at_us == 1_000_000
        assert found.rate_kev_s[[0, 100]].tolist() == [1.0, 11.0]
        assert found.moment[:20, 20].tolist() == [5] * 20
        assert found.moment[HOT[::-1]] == -RATE_US // 1_000
        age_us = 1_000_000 + RATE_US - 1_000_500
        assert found.surface[3, 20] == pytest.approx(np.exp(-age_us / SURFACE_US))
        assert found.surface[0, 0] == 0.0
        assert found.counts[HOT[::-1]] == 2_000
        assert found.hot_px.tolist() == [list(HOT)]


def test_every_kind_is_drawn_with_its_axes(recorded: Path) -> None:
    found = event_figures(open_events(recorded), at_s=0.5)
    assert found.at_us == 500_000
    labels = {"moment": "x (px)", "rate": "time (s)", "surface": "x (px)", "hot": "x (px)"}
    for kind, label in labels.items():
        assert plot_events(found, kind).axes[0].get_xlabel() == label
    drawn = plot_events(found, theme="dark").axes
    assert [axes.get_xlabel() for axes in drawn] == list(labels.values())
    assert "1 hot pixel" in drawn[3].get_title()
    with pytest.raises(ConfigError, match="did you mean 'moment'"):
        plot_events(found, "momnt")
    with pytest.raises(ConfigError, match="the events last 2 s"):
        event_figures(open_events(recorded), at_s=2.5)


def test_a_leap_of_the_clock_is_no_rate_and_hides_no_hot_pixel(tmp_path: Path) -> None:
    places, t_us = np.full(30_000, 7), np.append(np.arange(29_999) * 1_000, 10**15)
    save_events(tmp_path / "leap.npz", packet_of(t_us, places, places, places > 0, (32, 24)))
    leaping = open_events(tmp_path / "leap.npz")
    with pytest.raises(ConfigError, match="its clock leapt"):
        event_figures(leaping)
    assert hot_pixels_of(leaping).tolist() == [[7, 7]]


def test_events_have_one_colour_on_the_page_and_in_figures() -> None:
    style = (PACKAGE / "viewer" / "page" / "theme.css").read_text(encoding="utf-8")
    found = re.findall(r"--on: (#\w+); --off: (#\w+);", style)
    assert found == [(THEMES[name].on, THEMES[name].off) for name in ("dark", "light", "light")]


def test_a_hole_is_drawn_as_its_legend_says() -> None:
    axes = Figure().add_subplot()
    circle = Circle(np.array([0.03, 0.0]), RADIUS_MM, np.diag([0.02, 0.04, 0.02]) ** 2, RESIDUAL_MM)
    reading = circle.center_mm + 1.7 * np.column_stack([np.cos(ANGLE_RAD), np.sin(ANGLE_RAD)])
    truth = {"true_center_mm": np.zeros(2), "true_radius_mm": RADIUS_MM}
    one = HolePicture(circle=circle, reading_mm=reading, **truth)
    draw_hole(axes, one, THEMES["light"])
    handles, labels = axes.get_legend_handles_labels()
    drawn = dict(zip(labels, handles, strict=True))
    assert axes.get_aspect() == 1.0
    region = drawn[f"95 % region of the centre × {one.center_factor:g}"]
    assert isinstance(region, Ellipse)
    assert max(region.width, region.height) == pytest.approx(
        2.0 * one.center_factor * 0.04 * np.sqrt(PLANE_REGION)
    )
    away = drawn[f"true centre, its distance × {one.center_factor:g}"].get_xydata()[0]
    np.testing.assert_allclose(away, [0.03 * (1.0 - one.center_factor), 0.0], atol=1e-12)
    contacts = drawn[f"contacts, residual × {one.residual_factor:g}"].get_xydata()
    distance = np.linalg.norm(contacts - one.circle.center_mm, axis=1)
    np.testing.assert_allclose(distance, RADIUS_MM + one.residual_factor * RESIDUAL_MM)
