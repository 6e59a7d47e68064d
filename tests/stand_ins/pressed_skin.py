"""Marker frames of a skin that is pressed at one place, as a function of time."""

from collections.abc import Callable, Iterator

import numpy as np

from spikingtac.touch.detector import TouchDetector
from spikingtac.touch.touch import Touch
from spikingtac.types import MarkerFrame
from stand_ins.live import frame_of

PITCH_PX, NOISE_PX, RATE_HZ = 37.0, 0.012, 500.0
X, Y = np.meshgrid(np.arange(8.0), np.arange(8.0))
REFERENCE = PITCH_PX * np.column_stack([X.ravel(), Y.ravel()]) + 30.0
CENTER = np.array([160.0, 145.0])


def press(
    depth: float = 1.0, reference: np.ndarray = REFERENCE, center: np.ndarray = CENTER
) -> np.ndarray:
    """Markers spread away from a press, most at one and a half pitches from it."""
    away = (reference - center) / PITCH_PX
    return depth * away * np.exp(-0.5 * (away**2).sum(axis=1, keepdims=True) / 1.5**2)


PRESS = press()


def pulse(t_s: float, begin_s: float, end_s: float, rise_s: float = 0.2) -> float:
    """A press that grows as the square of time and is taken back alike."""
    return max(min((t_s - begin_s) / rise_s, (end_s - t_s) / rise_s, 1.0), 0.0) ** 2


def watch(
    depth: Callable[[float], float],
    seconds: float,
    reference: np.ndarray = REFERENCE,
    pattern: np.ndarray = PRESS,
    drift: float = 0.0,
) -> Iterator[MarkerFrame]:
    """Yield frames of a press of a depth over time, px, and a drift, px/s."""
    rng = np.random.default_rng(4)
    for k in range(int(seconds * RATE_HZ)):
        t_s = k / RATE_HZ
        moved = depth(t_s) * pattern + rng.normal(0.0, NOISE_PX, reference.shape) + drift * t_s
        yield frame_of(round(t_s * 1e6), reference, moved)


def touches(detector: TouchDetector, frames: Iterator[MarkerFrame]) -> list[Touch]:
    """Return the touches that a detector finds."""
    found = [touch for frame in frames if (touch := detector.update(frame))]
    last = detector.finish()
    return [*found, last] if last else found
