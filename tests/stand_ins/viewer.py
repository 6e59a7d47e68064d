"""A view whose every value is known in closed form, to compare the page with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from spikingtac.contact.detector import Window, count_of, packets_of
from spikingtac.events.source import EventSource
from spikingtac.types import Contact, EventPacket, LossCounters, MarkerFrame
from spikingtac.viewer.source import SampledTruth, ViewSource
from stand_ins.known import known
from stand_ins.live import BurstDetector
from stand_ins.random_packets import packet_of, save_events

SIZE = (320, 320)
GRID = (8, 8)
PITCH_PX = 37.0
RADIUS_PX = 7.0
SWING_PX = 6.0
PERIOD_US = 1_000_000
PACKET_US = 1_000
RIM = 24


def reference_px() -> np.ndarray:
    y, x = np.mgrid[0 : GRID[0], 0 : GRID[1]].astype(float)
    centered = np.stack([x.ravel() - (GRID[1] - 1) / 2, y.ravel() - (GRID[0] - 1) / 2], axis=1)
    return centered * PITCH_PX + (np.array(SIZE) - 1) / 2


def positions_px(t_us: float) -> np.ndarray:
    """Each marker circles its rest; those further from the centre circle wider."""
    rest = reference_px()
    reach = SWING_PX * np.hypot(*(rest - 159.5).T) / 180
    phase = 2 * np.pi * t_us / PERIOD_US
    return rest + reach[:, None] * np.array([np.sin(phase), 1 - np.cos(phase)])


class CirclingDots(EventSource):
    """Events on the rims of the moving discs: ON ahead of the motion, OFF behind."""

    def __init__(self, duration_us: int, noise_per_ms: int = 0) -> None:
        self.size = SIZE
        self.losses = LossCounters({"time_gap": 2})
        self._duration_us, self._noise = duration_us, noise_per_ms

    def __iter__(self) -> Iterator[EventPacket]:
        rng = np.random.default_rng(7)
        angle = np.linspace(0, 2 * np.pi, RIM, endpoint=False)
        rim = RADIUS_PX * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        for start_us in range(0, self._duration_us, PACKET_US):
            now, then = positions_px(start_us + PACKET_US), positions_px(start_us)
            ahead = ((now - then)[:, None, :] * rim[None]).sum(axis=2)
            chosen = np.abs(ahead) > rng.random(ahead.shape) * RADIUS_PX * 0.4
            x, y = np.rint((now[:, None, :] + rim[None])[chosen]).T
            p = ahead[chosen] > 0
            if self._noise:
                x = np.append(x, rng.integers(0, SIZE[0], self._noise))
                y = np.append(y, rng.integers(0, SIZE[1], self._noise))
                p = np.append(p, rng.random(self._noise) < 0.5)
            t = np.sort(rng.integers(start_us, start_us + PACKET_US, len(x)))
            yield packet_of(t, x, y, p, SIZE, (start_us, start_us + PACKET_US))


@dataclass(frozen=True, kw_only=True)
class Settings:
    gain: float = field(
        default=1.0, metadata={"range": (0.0, 2.0), "about": "Scale of the displacement."}
    )
    law: str = field(default="none", metadata={"choices": ("none", "paper")})
    hidden: float = 3.0


class KnowingTracker:
    """Knows where the markers are and scales their displacement by the gain."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.values = np.zeros((SIZE[1], SIZE[0]), np.float32)

    @property
    def state_map(self) -> KnowingTracker:
        return self

    def absorb(self, packet: EventPacket) -> None:
        self.values[packet.y, packet.x] = packet.p

    def estimate(self, t_us: int) -> MarkerFrame:
        rest, true = reference_px(), positions_px(t_us)
        displacement = self.settings.gain * (true - rest)
        held = np.arange(len(rest)) == 9
        confidence = np.where(held, 0.0, 0.9)
        return MarkerFrame(t_us, true, rest + displacement, displacement, held, confidence)

    def reset(self) -> None:
        self.values[:] = 0


class EverySecond(BurstDetector):
    """Reports a contact 0.3 s after each full second, which lasts for 0.2 s."""

    def update(self, window: Window) -> Contact | None:
        t_us = packets_of(window)[0].t_end_us
        self.in_contact = 300_000 <= t_us % PERIOD_US < 500_000
        return Contact(t_us, count_of(window), 20.0) if t_us % PERIOD_US == 300_000 else None


def open_circling(duration_us: int = 4_000_000) -> ViewSource:
    times_us = np.arange(0, duration_us + 1, 2_000)
    return ViewSource(
        label="circling dots",
        source=CirclingDots(duration_us, noise_per_ms=50),
        calibration=known(reference_px(), RADIUS_PX, SIZE, px_per_mm=15.5),
        config=Settings(),
        make_tracker=KnowingTracker,
        make_detector=EverySecond,
        truth=SampledTruth(times_us, np.stack([positions_px(t_us) for t_us in times_us])),
        simulated=True,
    )


def open_nothing() -> ViewSource:
    raise FileNotFoundError(2, "No such file or directory", "nowhere.raw")


def record_circling(folder: Path) -> Path:
    """Write 0.6 s of the circling discs and their calibration into a folder, and return it."""
    save_events(folder / "events.raw", *CirclingDots(duration_us=600_000, noise_per_ms=5))
    # With steps: `track` learns those of a file that has none, which takes its time.
    known = replace(open_circling().calibration, step_on=0.2, step_off=0.2)
    known.save(folder / "calibration.json")
    return folder
