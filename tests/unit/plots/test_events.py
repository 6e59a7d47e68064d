"""Figures of events: what is drawn is what the pixels sent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.events import create_events, open_events
from spikingtac.plots.events import RATE_US, SURFACE_US, event_figures, plot_events
from spikingtac.types import EventPacket

SIZE = (32, 24)
HOT = (5, 7)


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """A hot pixel at 1 kHz for 2 s, and a burst of 100 ON events of one column at 1.0 s."""
    hot_us = np.arange(0, 2_000_000, 1_000)
    t = np.concatenate([hot_us, np.full(100, 1_000_500)])
    x = np.concatenate([np.full(2_000, HOT[0]), np.full(100, 20)]).astype(np.uint16)
    y = np.concatenate([np.full(2_000, HOT[1]), np.arange(100) % 20]).astype(np.uint16)
    p = np.concatenate([np.zeros(2_000, bool), np.ones(100, bool)])
    order = np.argsort(t, kind="stable")
    columns = (column[order] for column in (x, y, p, t))
    with create_events(tmp_path / "a.raw", SIZE) as writer:
        writer.write(EventPacket(*columns, 0, 2_000_000, SIZE))
    return tmp_path / "a.raw"


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
