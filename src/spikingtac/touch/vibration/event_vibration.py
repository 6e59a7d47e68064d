"""Vibration straight from events: its line in their spectrum, its amplitude from their counts.

Trackers smooth, and see nothing below an event's threshold. Events are faster: ahead of a moving
edge they are ON, behind it OFF, so the sum of their directions follows the velocity of the skin,
and random ones cancel. What only drifts through a threshold (leak, noise) is released by the
smallest vibration at its own phase, which tells it from rest. Lamps that flicker make all
directions alike and leave no line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.hot_pixels import HotPixelFilter
from spikingtac.touch.vibration.edge_counts import Edge
from spikingtac.touch.vibration.line_search import Band, strongest_line
from spikingtac.touch.vibration.rim_amplitude import UNTOLD, Amplitude, RimCounts, rim_amplitude
from spikingtac.touch.vibration.rim_cells import RimCells, ring_distances_px, sector_normals
from spikingtac.touch.vibration.rim_memory import BIN_US, RimMemory
from spikingtac.types import EventPacket, MarkerFrame

Field = NDArray[np.float64]

US_PER_S = 1e6
USUAL_STEP = 0.14
"""Share of the swing of an event where the calibration tells none: 0.25 of ln 6."""

LEAST_BINS = 2
"""Bins from the first to the last that is looked at, at least: a line is a peak between two."""
EDGE_REACH_PX = 1.5
"""Pixels within this distance of an edge tell the line, px; farther ones tell noise (ours)."""


@dataclass(frozen=True, kw_only=True)
class EventVibrationConfig:
    """How vibration is measured from events.

    Attributes:
        window_s: Length of the spectrum, s: bins of 1 Hz.
        lowest_hz: Motions slower than this are touch, not vibration, Hz (ours).
        highest_hz: Highest frequency that is looked at, Hz.
        line_ratio: Amplitude of a line over the median of its neighbours that is no noise (ours:
            white noise exceeds it in less than 1 of 1,000 spectra).
        neighbours: Bins on both sides that tell the noise.
        replaced_us: How often the rims follow the markers, us.
    """

    window_s: float = 1.0
    lowest_hz: float = 10.0
    highest_hz: float = 1_000.0
    line_ratio: float = 3.5
    neighbours: int = 32
    replaced_us: int = 100_000

    def __post_init__(self) -> None:
        if not 0 < self.lowest_hz < self.highest_hz <= 0.5 * US_PER_S / BIN_US:
            raise ValueError("0 < lowest_hz < highest_hz <= 2,000 must hold")
        if not 4 <= self.window_s * self.lowest_hz < np.inf or not self.line_ratio > 1:
            raise ValueError(
                "a window is finite and holds 4 cycles of lowest_hz, line_ratio is above 1"
            )
        bins = np.floor(self.highest_hz * self.window_s) - np.ceil(self.lowest_hz * self.window_s)
        if bins < LEAST_BINS:
            raise ValueError(
                f"from {self.lowest_hz} to {self.highest_hz} Hz there are {bins + 1:.0f} bins in a "
                f"window of {self.window_s} s, a line needs {LEAST_BINS + 1}"
            )
        if self.neighbours < 8 or self.replaced_us < BIN_US:
            raise ValueError(f"neighbours is at least 8, replaced_us at least {BIN_US}")


@dataclass(frozen=True, slots=True)
class VibrationLine:
    """The strongest line of the last window.

    Attributes:
        t_us: End of the window, us.
        hz: Frequency, Hz.
        ratio: Its strength over that of the noise.
        amplitude_px: Of the sine along its main direction, px; None where the events are too few
            to tell it (below about a threshold), or the calibration does not know the edges.
        sigma_px: One standard deviation of it, px; None with it.
        direction: ``(2,)`` main direction of the motion, a unit vector.
    """

    t_us: int
    hz: float
    ratio: float
    amplitude_px: float | None
    sigma_px: float | None
    direction: Field


class EventVibrationMonitor:
    """Keeps the events of the last second at the rims and computes their line on request.

    Example:
        >>> monitor = EventVibrationMonitor(calibration)  # doctest: +SKIP
        >>> for packet in source:  # doctest: +SKIP
        ...     monitor.absorb(packet)
        >>> monitor.line().hz  # doctest: +SKIP
        120.02
    """

    def __init__(
        self, calibration: Calibration, config: EventVibrationConfig | None = None
    ) -> None:
        """Start with the markers at rest."""
        self._calibration, self._config = calibration, config or EventVibrationConfig()
        self._hot = HotPixelFilter(calibration.hot_px, calibration.size)
        self._cells = RimCells(calibration.radius_px, calibration.size)
        self._cells.place(calibration.reference_px)
        self._memory = RimMemory(round(self._config.window_s * US_PER_S / BIN_US))
        self._placed_us: int | None = None
        self._places = np.zeros_like(calibration.reference_px)
        self._frames = 0

    @property
    def window_us(self) -> int:
        """Length of the window, us."""
        return round(self._config.window_s * US_PER_S)

    def reset(self) -> None:
        """Forget everything; the markers are at rest."""
        self._memory.reset()
        self._cells.place(self._calibration.reference_px)
        self._placed_us, self._frames = None, 0
        self._places[:] = 0.0

    def follow(self, frame: MarkerFrame) -> None:
        """Let the rims follow the markers' mean places, as a touch moves them slowly.

        A frame of an earlier time begins a new mean.
        """
        if self._placed_us is None or frame.t_us < self._placed_us:
            self._placed_us, self._frames = frame.t_us, 0
            self._places[:] = 0.0
        self._places += frame.detected_px
        self._frames += 1
        if frame.t_us - self._placed_us >= self._config.replaced_us:
            self._cells.place(self._places / self._frames)
            self._places[:] = 0.0
            self._placed_us, self._frames = frame.t_us, 0

    def absorb(self, packet: EventPacket) -> None:
        """Take in events.

        Raises:
            ConfigError: They are of another sensor.
        """
        self._memory.absorb(self._hot.kept(packet), self._cells.cell)

    def line(self) -> VibrationLine | None:
        """Return the strongest line of the last window; None before it is full, or at rest."""
        t_us = self._memory.t_us
        if t_us is None or not self._memory.full:
            return None
        counts = self._memory.counts()
        velocity = self._velocity(counts)
        found = self._strongest(velocity)
        if found is None:
            return None
        hz, ratio = found
        phasor = self._phasor(velocity, hz)
        main = _main_direction(phasor)
        told = self._amplitude(counts, hz, phasor)
        return VibrationLine(t_us, hz, ratio, told.px, told.sigma_px, main)

    def _strongest(self, velocity: Field) -> tuple[float, float] | None:
        config = self._config
        band = Band(config.lowest_hz, config.highest_hz, config.line_ratio, config.neighbours)
        return strongest_line(velocity, US_PER_S / BIN_US, band)

    def _weights(self) -> Field:
        """Return ``(RINGS, SECTORS, 2, 2)`` what an event says of the motion along x and y."""
        known = self._calibration
        off = USUAL_STEP if known.step_off is None else known.step_off
        on = USUAL_STEP if known.step_on is None else known.step_on
        sense = 1.0 if known.polarity == "white" else -1.0
        steps = sense * np.array([-off, on])
        near = np.abs(ring_distances_px()) < EDGE_REACH_PX
        return (
            near[:, None, None, None] * sector_normals()[None, :, None] * steps[None, None, :, None]
        )

    def _velocity(self, counts: NDArray[np.float32]) -> Field:
        weights = self._weights().reshape(-1, 2).astype(np.float32)
        return (counts.reshape(len(counts), -1) @ weights).astype(np.float64)

    def _phasor(self, velocity: Field, hz: float) -> NDArray[np.complex128]:
        """Return the complex strength ``(2,)`` of the motion at a frequency, unscaled."""
        time_s = np.arange(len(velocity)) * (BIN_US / US_PER_S)
        turning = np.hanning(len(velocity)) * np.exp(-2j * np.pi * hz * time_s)
        return np.asarray(turning @ velocity, np.complex128)

    def _amplitude(
        self, counts: NDArray[np.float32], hz: float, phasor: NDArray[np.complex128]
    ) -> Amplitude:
        edge = calibrated_edge(self._calibration)
        if edge is None:
            return UNTOLD
        cycles = hz * len(counts) * BIN_US / US_PER_S
        pixels = self._cells.pixels
        totals = counts.sum(axis=0, dtype=np.float64).transpose(2, 0, 1)
        across = np.abs(sector_normals() @ phasor)
        counted = RimCounts(
            hz=hz,
            per_cycle=totals / np.maximum(pixels, 1) / cycles,
            pixels=pixels,
            across=across / _largest(phasor),
            white=self._calibration.polarity == "white",
        )
        return rim_amplitude(counted, edge)


def calibrated_edge(calibration: Calibration) -> Edge | None:
    """Return what a calibration knows of the edges; None where it lacks a part."""
    contrast, width = calibration.contrast, calibration.edge_px
    on, off = calibration.step_on, calibration.step_off
    if contrast is None or width is None or on is None or off is None:
        return None
    ratio = max(contrast, 1.0 / contrast)
    swing = float(np.log(ratio))
    return Edge(ratio, width, on * swing, off * swing, 0.0, 0.0)


def _axes(phasor: NDArray[np.complex128]) -> tuple[Field, Field]:
    """Return the lengths ``(2,)``, falling, and directions ``(2, 2)`` of an elliptic motion."""
    parts = np.stack([phasor.real, phasor.imag], axis=1)
    directions, lengths, _ = np.linalg.svd(parts)
    return lengths, directions.T


def _largest(phasor: NDArray[np.complex128]) -> float:
    return float(_axes(phasor)[0][0])


def _main_direction(phasor: NDArray[np.complex128]) -> Field:
    return _axes(phasor)[1][0]
