"""The contacts of :mod:`twin_wrench` as a tracker sees them by events, through a camera."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from spikingtac import follow, make_tracker
from spikingtac.config import load_config
from spikingtac.sim import SceneSource, load_scene
from spikingtac.touch import WrenchSeries
from spikingtac.types import EventPacket
from spikingtac_paper.touch.true_calibration import true_calibration

RATE_HZ = 250.0
"""Estimates per second: those of the gel's steps."""
N_MM_PER_NM = 1e3


class _WithWrench:
    """A scene's packets; the wrench goes into a list on the way."""

    def __init__(self, source: SceneSource) -> None:
        self._source = source
        self.size = source.size
        self.t_us: list[NDArray[np.int64]] = []
        self.wrench: list[NDArray[np.float64]] = []

    def __iter__(self) -> Iterator[EventPacket]:
        for step in self._source.steps():
            truth = step.truth
            self.t_us.append(truth.contact_t_us)
            self.wrench.append(np.hstack([truth.force_n, truth.torque_n_mm / N_MM_PER_NM]))
            yield step.packet


def tracked_series(name: str, seed: int, camera: str) -> WrenchSeries:
    """Return what `default` tracks of a scene, and the wrench.

    Args:
        name: The scene.
        seed: Of its variations and of the camera's noise.
        camera: Preset of the camera.
    """
    scene = load_scene(name).with_camera(camera)
    source = SceneSource(scene, seed)
    watched, times, moved = _WithWrench(source), [], []
    tracker = make_tracker(load_config("default").tracking, true_calibration(source))
    for frame in follow(watched, tracker, RATE_HZ):
        times.append(frame.t_us)
        moved.append(frame.detected_px - source.reference_px)
    true_us, wrench = np.concatenate(watched.t_us), np.concatenate(watched.wrench)
    at_frames = [np.interp(times, true_us, column) for column in wrench.T]
    return WrenchSeries(
        np.array(times, np.int64),
        source.reference_px,
        np.array(moved),
        np.column_stack(at_frames),
        "px",
        name,
    )
