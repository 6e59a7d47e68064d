"""Figures of a recording's events, without a calibration: a moment, the rate, a time surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError, named
from spikingtac.events.hot_pixels import hot_pixels_of
from spikingtac.plots.figure import FONT_PT, Theme, new_figure, style_axes
from spikingtac.types import US_PER_DAY, US_PER_S, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from spikingtac.events.formats.file_source import FileSource
    from spikingtac.types import EventPacket


# Time over which events are counted, us: a slow motion still fills it, a tap is not blurred.
RATE_US = 10_000

# Time constant of the surface, us: exp(-age / constant), as in Lagorce et al., "HOTS" (2017).
SURFACE_US = 50_000

FAINT = 0.01  # Share of the surface below which a pixel is not drawn: it fired 0.23 s ago.

# Height over width of figures that are no picture of the sensor.
HEIGHTS: dict[str, float] = {"rate": 0.62, "overview": 1.0}


@dataclass(frozen=True)
class EventFigures:
    """What the figures show of a recording.

    Attributes:
        at_us: Begin of the moment, us.
        first_us: Time of the first event, us.
        rate_kev_s: Events per second in each :data:`RATE_US` from the first event on, thousands.
        moment: ``(height, width)`` ON minus OFF events within :data:`RATE_US` from ``at_us`` on.
        surface: ``(height, width)`` exp(-age of the last event / :data:`SURFACE_US`) at its end.
        counts: ``(height, width)`` events of the whole recording.
        hot_px: ``(h, 2)`` columns and rows of the hot pixels.
    """

    at_us: int
    first_us: int
    rate_kev_s: FloatArray
    moment: NDArray[np.int64]
    surface: FloatArray
    counts: NDArray[np.int64]
    hot_px: NDArray[np.int64]


def event_figures(source: FileSource, at_s: float | None = None) -> EventFigures:
    """Read a recording and return what its figures show, at constant memory.

    Args:
        source: The recording, from :func:`spikingtac.open_events`; it is read several times.
        at_s: Begin of the moment, s after the first event; the busiest one unless given.

    Raises:
        ConfigError: The recording holds no event, or none at that time.
    """
    # First pass: events of each pixel, and the rate over time.
    width, height = source.size
    counts, rate = np.zeros(width * height, np.int64), np.zeros(0, np.int64)
    first_us = None
    for packet in source:
        if len(packet):
            first_us = int(packet.t[0]) if first_us is None else first_us
            if packet.t[-1] - first_us > US_PER_DAY:  # memory for the rate
                raise ConfigError(
                    f"{source.path.name!r} goes over more than a day, or its clock leapt; cut a "
                    "part out: spikingtac convert RECORDING OUT --from-us N --to-us N"
                )
            counts += np.bincount(_pixel(packet), minlength=len(counts))
            more = np.bincount((packet.t - first_us) // RATE_US, minlength=len(rate))
            more[: len(rate)] += rate
            rate = more
    if first_us is None:
        raise ConfigError(f"{source.path.name!r} holds no events; there is nothing to draw")
    lasts_s = len(rate) * RATE_US / US_PER_S
    if at_s is not None and not 0.0 <= at_s < lasts_s:
        raise ConfigError(f"nothing was recorded at {at_s:g} s; the events last {lasts_s:g} s")
    after_us = int(rate.argmax()) * RATE_US if at_s is None else round(at_s * US_PER_S)
    # Second pass: what the sensor shows at the moment.
    moment, last_us = _until(source, first_us + after_us)
    age_us = first_us + after_us + RATE_US - last_us
    return EventFigures(
        at_us=first_us + after_us,
        first_us=first_us,
        rate_kev_s=rate / (RATE_US / US_PER_S) / 1e3,
        moment=moment.reshape(height, width),
        surface=np.exp(-age_us / SURFACE_US).reshape(height, width),
        counts=counts.reshape(height, width),
        hot_px=hot_pixels_of(source),
    )


def _until(source: FileSource, at_us: int) -> tuple[NDArray[np.int64], FloatArray]:
    """Return ON minus OFF events of the moment, and when each pixel sent last before its end."""
    pixels = source.size[0] * source.size[1]
    moment, last_us = np.zeros(pixels, np.int64), np.full(pixels, -np.inf)
    for packet in source:
        if packet.t_start_us >= at_us + RATE_US:
            break
        packet = packet.select(packet.t < at_us + RATE_US)
        pixel = _pixel(packet)
        last_us[pixel] = packet.t  # of equal pixels the last one stays
        now = packet.t >= at_us
        np.add.at(moment, pixel[now], np.where(packet.p[now], 1, -1))
    return moment, last_us


def _pixel(packet: EventPacket) -> NDArray[np.int64]:
    return packet.y.astype(np.int64) * packet.size[0] + packet.x


def plot_events(
    figures: EventFigures, kind: str = "overview", *, theme: str = "light", width: str = "single"
) -> Figure:
    """Draw a recording's events.

    Args:
        figures: From :func:`event_figures`.
        kind: ``moment`` (ON and OFF events), ``rate`` (over time), ``surface`` (how recent the last
            event of each pixel is), ``hot`` (events of each pixel, hot ones marked), or
            ``overview``, all of them.
        theme: ``light`` or ``dark``.
        width: ``single`` or ``double`` column.

    Raises:
        ConfigError: A name is unknown.
    """
    draws = _DRAWS if kind == "overview" else {kind: named(_DRAWS, kind, "kind of plot")}
    rows, columns = figures.counts.shape
    figure, colors = new_figure(theme, width, HEIGHTS.get(kind) or rows / columns)
    panels = figure.subplots(*((2, 2) if len(draws) > 1 else (1, 1)), squeeze=False)
    for axes, draw in zip(panels.flat, draws.values(), strict=True):
        style_axes(axes, colors)
        draw(axes, figures, colors)
        axes.title.set(color=colors.text, fontsize=FONT_PT)
    return figure


def _draw_moment(axes: Axes, figures: EventFigures, theme: Theme) -> None:
    from matplotlib.colors import LinearSegmentedColormap

    colors = LinearSegmentedColormap.from_list("polarity", (theme.off, theme.ground, theme.on))
    size = np.abs(figures.moment)
    bound = float(np.median(size[size > 0])) if size.any() else 1.0  # busy pixels hide no others
    axes.imshow(figures.moment, cmap=colors, vmin=-bound, vmax=bound)
    at_s = (figures.at_us - figures.first_us) / US_PER_S
    axes.set(title=f"ON (blue), OFF (purple)\n{RATE_US // 1000} ms from {at_s:.3f} s")
    axes.set(xlabel="x (px)", ylabel="y (px)")


def _draw_rate(axes: Axes, figures: EventFigures, theme: Theme) -> None:
    t_s = np.arange(len(figures.rate_kev_s)) * RATE_US / US_PER_S
    axes.plot(t_s, figures.rate_kev_s, color=theme.strong, linewidth=0.7)
    axes.set(
        title="event rate\nline: the moment",
        xlabel="time (s)",
        ylabel="thousand events / s",
        ylim=(0, None),
    )
    axes.axvline((figures.at_us - figures.first_us) / US_PER_S, color=theme.second, linewidth=0.7)


def _draw_surface(axes: Axes, figures: EventFigures, theme: Theme) -> None:
    recent = np.ma.masked_less(figures.surface, FAINT)
    axes.imshow(recent, cmap=theme.magnitudes(), vmin=0.0, vmax=1.0)
    axes.set(title=f"time surface\n{SURFACE_US // 1000} ms", xlabel="x (px)", ylabel="y (px)")


def _draw_hot(axes: Axes, figures: EventFigures, theme: Theme) -> None:
    axes.imshow(np.log10(1.0 + np.ma.masked_equal(figures.counts, 0)), cmap=theme.magnitudes())
    axes.plot(*figures.hot_px.T, "o", mfc="none", color=theme.second, markersize=5)
    found = f"{len(figures.hot_px)} hot pixels" if len(figures.hot_px) != 1 else "1 hot pixel"
    axes.set(title=f"events per pixel (log)\n{found}", xlabel="x (px)", ylabel="y (px)")


_DRAWS = {
    "moment": _draw_moment,
    "rate": _draw_rate,
    "surface": _draw_surface,
    "hot": _draw_hot,
}
