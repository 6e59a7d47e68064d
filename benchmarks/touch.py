"""What the parts of touch cost for 64 markers, beside the tracker's own step.

    python benchmarks/touch.py force.json RECORDING CALIBRATION

``force.json`` comes from ``spikingtac force fit``. The tracker and what is felt take turns on every
millisecond of the recording, so that a busy machine slows all of them: its tenth percentile is
what an idle one needs. One thread. Set ``OPENBLAS_NUM_THREADS=1``.
"""

from __future__ import annotations

import sys
from time import perf_counter

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.events.open import open_events
from spikingtac.events.windows import windows
from spikingtac.markers.registry import make_tracker
from spikingtac.touch.force.files.model_file import load_force
from spikingtac.touch.indentation.monitor import PERIOD_US as PERIOD_OF_INDENTATION_US
from spikingtac.touch.indentation.monitor import IndentationMonitor
from spikingtac.touch.slip.held_touches import HeldTouchDetector
from spikingtac.touch.vibration.spectrum import VibrationMonitor

PERIOD_US = 1_000
WARM_UP_STEPS = 100
STEPS = 2_000
MEASURE_STEPS = PERIOD_OF_INDENTATION_US // PERIOD_US
"""Steps between two measurements of the indentation."""
CAMERA_DISTANCE_MM = 13.0
"""The twin's."""


def main() -> None:
    """Time the steps in turns and print their medians."""
    force_path, recording, calibration_path = sys.argv[1:4]
    calibration = Calibration.load(calibration_path)
    tracker = make_tracker(load_config("default").tracking, calibration)
    estimator = load_force(force_path).estimator()
    detector = HeldTouchDetector(calibration.reference_px)
    monitor = VibrationMonitor(1e6 / PERIOD_US)
    indentation = IndentationMonitor(calibration, CAMERA_DISTANCE_MM)
    costs: list[list[float]] = []
    for number, packet in enumerate(windows(open_events(recording), period_us=PERIOD_US)):
        if number == STEPS:
            break
        stamps = [perf_counter()]
        tracker.absorb(packet)
        frame = tracker.estimate(packet.t_end_us)
        stamps.append(perf_counter())
        detector.update(frame)
        stamps.append(perf_counter())
        estimator.update(frame.t_us, frame.detected_px - calibration.reference_px)
        stamps.append(perf_counter())
        monitor.update(frame.t_us, frame.detected_px - calibration.reference_px)
        stamps.append(perf_counter())
        indentation.absorb(packet)
        indentation.update(frame, detector.touches.tracked_px, detector.touches.touching)
        stamps.append(perf_counter())
        costs.append(np.diff(stamps).tolist())
    table = 1e6 * np.array(costs[WARM_UP_STEPS:])
    names = ("tracker step", "touches, slip", "force", "vibration", "indentation")
    for name, column in zip(names, table.T, strict=True):
        print(f"{name:14s} p50 {np.median(column):7.1f} us, p10 {np.quantile(column, 0.1):7.1f} us")
    measured = table[:, -1]
    measured = measured[measured > np.quantile(measured, 1.0 - 1.0 / MEASURE_STEPS)]
    print(f"indentation, every {MEASURE_STEPS}th step: p50 {np.median(measured):7.1f} us")
    felt = table[:, 1:].sum(axis=1)
    print(f"all of touch   p50 {np.median(felt):7.1f} us, p10 {np.quantile(felt, 0.1):7.1f} us")


if __name__ == "__main__":
    main()
