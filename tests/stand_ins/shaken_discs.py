"""Events of four discs on a sensor that shakes, as pixels without lag or dead time see them."""

from __future__ import annotations

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.touch.vibration.edge_counts import Edge
from spikingtac.types import EventPacket

EDGE = Edge(6.0, 0.35, 0.25, 0.25, 100.0, 60.0)
SIZE = (90, 90)
CENTERS = np.array([[25.0, 25.0], [62.0, 25.3], [25.2, 62.0], [62.0, 61.6]])
CALIBRATION = Calibration(
    reference_px=CENTERS,
    radius_px=np.full(4, 6.5),
    grid=(2, 2),
    size=SIZE,
    contrast=EDGE.contrast,
    edge_px=EDGE.width_px,
    step_on=0.25 / np.log(6.0),
    step_off=0.25 / np.log(6.0),
)


def shaken_stream(hz: float, amplitude_px: float, seconds: float, seed: int = 0) -> EventPacket:
    """White discs that move along x, seen by pixels without lag or dead time, 20,000 times a s."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    away = np.min([np.hypot(x - cx, y - cy) for cx, cy in CENTERS], axis=0)
    rows = np.flatnonzero((np.abs(away - 6.5) < 4.0).ravel())
    near = np.argmin([np.hypot(x - cx, y - cy) for cx, cy in CENTERS], axis=0).ravel()[rows]
    px, py = x.ravel()[rows], y.ravel()[rows]
    rng = np.random.default_rng(seed)
    last, columns = None, []
    for k in range(round(seconds * 20_000)):
        shift = amplitude_px * np.sin(2.0 * np.pi * hz * k / 20_000)
        q = np.hypot(px - CENTERS[near, 0] - shift, py - CENTERS[near, 1]) - 6.5
        level = np.log1p(5.0 / (1.0 + np.exp(q / EDGE.width_px)))
        last = level - rng.uniform(-0.25, 0.25, len(rows)) if last is None else last
        steps = np.trunc((level - last) / 0.25)
        last = last + 0.25 * steps
        fired = np.flatnonzero(steps)
        for one in np.repeat(fired, np.abs(steps[fired]).astype(int)):
            columns.append((px[one], py[one], steps[one] > 0, 50 * k))
    noise = rng.poisson(2_000 * seconds)
    for t_us in rng.integers(0, round(seconds * 1e6), noise).tolist():
        columns.append((*rng.integers(0, 90, 2), rng.random() < 0.5, t_us))
    columns.sort(key=lambda one: one[3])
    xs, ys, ps, ts = (np.array(column) for column in zip(*columns, strict=True))
    return EventPacket(xs.astype(np.uint16), ys.astype(np.uint16), ps.astype(np.bool_),
                       ts.astype(np.int64), 0, round(seconds * 1e6), SIZE)  # fmt: skip
