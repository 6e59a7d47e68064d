"""Ideal pixels whose OFF threshold exceeds their ON threshold, written apart from the twin."""

from collections.abc import Iterable

import numpy as np

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.types import EventPacket
from stand_ins.known import known
from stand_ins.random_packets import packet_of

SIZE = (96, 64)
REST_PX = np.array([[24.0, 20.0], [62.0, 20.0], [24.0, 46.0], [62.0, 46.0]])
RADIUS_PX, STEP_ON, STEP_OFF, PERIOD_US = 6.0, 0.13, 0.37, 1_000
PROFILE = DiscProfile(3.5, 0.9)
MISMATCH = 0.12


def presses_px() -> np.ndarray:
    """Return ``(n, 4, 2)`` places: three presses of 0.3 s that spread the markers by up to 6 px."""
    phase = np.arange(1_500) / 500.0
    depth = np.clip(3.0 * np.minimum(phase % 1.0 - 0.2, 0.8 - phase % 1.0), 0.0, 0.6) / 0.6
    apart = REST_PX - REST_PX.mean(axis=0)
    return REST_PX + depth[:, None, None] * 6.0 * apart / np.hypot(*apart.T).max()


def levels(
    center_px: np.ndarray,
    profile: DiscProfile = PROFILE,
    size: tuple[int, int] = SIZE,
    radius_px: np.ndarray | float = RADIUS_PX,
) -> np.ndarray:
    """Return ``(height, width)`` shares of a full swing of discs, of one radius or of their own."""
    y, x = np.mgrid[: size[1], : size[0]]
    out = np.zeros((size[1], size[0]))
    radii_px = np.broadcast_to(radius_px, len(center_px))
    for (cx, cy), radius in zip(center_px, radii_px, strict=True):
        np.maximum(out, profile.level(np.hypot(x - cx, y - cy) - radius), out=out)
    return out


Steps = np.ndarray | float


def fired(
    maps: Iterable[np.ndarray], on: Steps, off: Steps, known: np.ndarray | None = None
) -> np.ndarray:
    """Return sample, pixel and polarity of the events of ideal pixels that follow levels.

    Args:
        maps: The levels, sample by sample.
        on: Change since its last event at which a pixel fires, when it becomes brighter.
        off: The same when it becomes darker.
        known: Levels at the last events, those of the first sample unless given.
    """
    events = []
    for sample, level in enumerate(maps):
        now = level.ravel()
        known = now.copy() if known is None else known
        for rises, step in ((1, on), (0, -off)):
            while len(pixels := np.flatnonzero((now - known - step) * np.sign(step) > 0.0)):
                known[pixels] += np.broadcast_to(step, now.shape)[pixels]
                events.append([0 * pixels + sample, pixels, 0 * pixels + rises])
    return np.concatenate(events, axis=1)


def rare_off_events() -> EventPacket:
    """Return the events of :func:`presses_px`, for pixels of unlike thresholds."""
    rng, shape = np.random.default_rng(1), SIZE[1] * SIZE[0]
    on, off = (step * (1.0 + MISMATCH * rng.normal(size=shape)) for step in (STEP_ON, STEP_OFF))
    known = levels(presses_px()[0]).ravel() + rng.uniform(-on, off)  # the last contact
    sample, pixels, rises = fired(map(levels, presses_px()), on, off, known)
    t_us = sample * PERIOD_US + rng.integers(0, PERIOD_US, len(sample))
    order = np.argsort(t_us, kind="stable")
    y, x = np.divmod(pixels[order], SIZE[0])
    return packet_of(t_us[order], x, y, rises[order], SIZE, (0, len(presses_px()) * PERIOD_US))


def rare_off_calibration() -> Calibration:
    """Return what a perfect calibration of that sensor knows."""
    edge = {"contrast": PROFILE.contrast, "edge_px": PROFILE.edge_px, "lag_us": 0.0}
    return known(REST_PX, RADIUS_PX, SIZE, step_on=STEP_ON, step_off=STEP_OFF, **edge)
