"""Cost of one step of the gel while bodies press, slide, twist and roll, on one thread.

Thread time, so that waiting for a busy machine does not count; a loaded machine still slows the
caches, so the transform of the grid is timed in the same run as a yardstick. The last column is
the share of one core that the mechanics take at the given rate.

    python benchmarks/gel.py [steps per second]
"""

from __future__ import annotations

import sys
from time import thread_time

import numpy as np
import scipy.fft

from spikingtac.sim.gel.gel import Gel, GelConfig
from spikingtac.sim.gel.indenters import IndenterConfig, make_indenter
from spikingtac.sim.scene.motions import IndenterMotion, MotionConfig, SegmentConfig

RATE_HZ = 250.0
PITCH_MM = 2.5
TRANSFORMS = 200
PRESS_S = 0.3

SLIDE = SegmentConfig(kind="slide", dx_mm=4.0, speed_mm_s=20.0)
RUB = SegmentConfig(kind="rub", dx_mm=3.0, repeats=4, speed_mm_s=60.0)
TWIST = SegmentConfig(kind="twist", angle_deg=60.0, duration_s=0.6)
CIRCLE = SegmentConfig(kind="circle", radius_mm=2.0, turns=2.0, duration_s=1.0)
ROLL = SegmentConfig(kind="roll", dx_mm=4.0, radius_mm=4.0, speed_mm_s=20.0)
HOLD = SegmentConfig(kind="hold", duration_s=1.0)
LIFT = SegmentConfig(kind="lift", duration_s=0.1)

CASES = {
    "press and hold": ("finger", 1.0, HOLD),
    "slide": ("finger", 1.0, SLIDE),
    "rub": ("finger", 1.0, RUB),
    "torsion": ("finger", 1.2, TWIST),
    "circles": ("finger", 1.0, CIRCLE),
    "spoon slide": ("spoon", 0.6, SLIDE),
    "comb slide": ("comb", 0.5, SLIDE),
    "punch slide": ("punch", 0.5, SLIDE),
    "ball roll": ("ball", 0.6, ROLL),
}


def markers_mm() -> np.ndarray:
    axis = (np.arange(8) - 3.5) * PITCH_MM
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


def steps_ms(
    gel: Gel, kind: str, depth_mm: float, segment: SegmentConfig, rate: float
) -> np.ndarray:
    """Return the cost of every step in contact, ms."""
    press = SegmentConfig(kind="press", depth_mm=depth_mm, duration_s=PRESS_S)
    motion = IndenterMotion(MotionConfig(height_mm=0.1, segments=(press, segment, LIFT)))
    indenter = make_indenter(IndenterConfig(kind=kind))
    costs = []
    gel.reset()
    for step in range(1, int(motion.duration_s * rate) + 1):
        pose = motion.pose(step / rate)
        start = thread_time()
        state = gel.step(1.0 / rate, indenter, pose)
        if state.in_contact:
            costs.append((thread_time() - start) * 1e3)
    return np.array(costs)


def transform_ms(cells: int) -> float:
    field = np.ones((3, cells, cells))
    start = thread_time()
    for _ in range(TRANSFORMS):
        scipy.fft.rfft2(field, workers=1)
    return (thread_time() - start) / TRANSFORMS * 1e3


def main() -> None:
    rate = float(sys.argv[1]) if len(sys.argv) > 1 else RATE_HZ
    gel = Gel(GelConfig(), markers_mm())
    steps_ms(gel, "finger", 0.5, HOLD, rate)  # compiles, untimed
    print(f"{'case':16} {'p50 ms':>7} {'p99 ms':>7} {'mean ms':>8} {'of one core':>12}")
    for name, (kind, depth_mm, segment) in CASES.items():
        ms = steps_ms(gel, kind, depth_mm, segment, rate)
        middle, slow, mean = np.median(ms), np.quantile(ms, 0.99), ms.mean()
        print(f"{name:16} {middle:7.2f} {slow:7.2f} {mean:8.2f} {mean * rate / 1e3:12.2f}")
    print(f"three transforms of the grid: {transform_ms(64):.3f} ms in this run")


if __name__ == "__main__":
    main()
