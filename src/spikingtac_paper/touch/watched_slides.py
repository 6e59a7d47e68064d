"""Drawn contacts as a sensor sees them, beside the truth of what sticks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac import follow, make_tracker
from spikingtac.config import load_config
from spikingtac.sim import SceneSource, Timeline
from spikingtac.touch import TouchDetector
from spikingtac.types import EventPacket, MarkerFrame
from spikingtac_paper.touch.slides import Slide
from spikingtac_paper.touch.true_calibration import true_calibration

Field = NDArray[np.float64]
Times = NDArray[np.int64]
Flags = NDArray[np.bool_]

RATE_HZ = 1_000.0
LEAST_CELLS = 20
"""Cells of the skin below which a share of them says little (ours: 3 mm2)."""
ARM_MM = 3.0
"""Arm at which a turn counts as a motion, mm."""
STILL_MM_S = 0.5
"""Speed of the body below which it stands, mm/s."""
HELD_SHARE = 0.9
"""Sticking share below which a contact has slipped: what it carries while it stands is no longer
told by what sticks."""


@dataclass(frozen=True, slots=True)
class WatchedSlide:
    """A contact, frame by frame.

    Attributes:
        slide: What was done.
        reference_px: ``(m, 2)`` markers at rest, px.
        t_us: ``(n,)`` times, us.
        moved_px: ``(n, m, 2)`` displacements from the rest before the touch, px, as slip sees them.
        touching: ``(n,)`` whether a touch was noticed.
        share: ``(n,)`` true share of the touching cells that stick; nan where few touch.
        judged: ``(n,)`` whether that share tells what the contact can still carry: the body moves,
            or it has never slipped.
    """

    slide: Slide
    reference_px: Field
    t_us: Times
    moved_px: Field
    touching: Flags
    share: Field
    judged: Flags


def watch_slide(slide: Slide, seed: int, camera: str = "typical") -> WatchedSlide:
    """Return a contact seen by a camera and the tracker ``default``."""
    source = SceneSource(slide.scene.with_camera(camera), seed)
    truth: list[tuple[int, int, int]] = []
    tracker = make_tracker(load_config("default").tracking, true_calibration(source))
    frames = follow(_Packets(source, truth), tracker, RATE_HZ)
    return _watched(slide, source.reference_px, list(frames), truth)


class _Packets:
    """The events of a source, with the truth of what sticks kept on the way."""

    def __init__(self, source: SceneSource, truth: list[tuple[int, int, int]]) -> None:
        self._source, self._truth, self.size = source, truth, source.size

    def __iter__(self) -> Iterator[EventPacket]:
        for step in self._source.steps():
            told = step.truth
            for row, t_us in enumerate(told.contact_t_us.tolist()):
                cells = _cells(told.touching_cells[row], told.sticking_cells[row])
                self._truth.append((t_us, *cells))
            yield step.packet


def _cells(touching: NDArray[np.uint8], sticking: NDArray[np.uint8]) -> tuple[int, int]:
    return int(np.bitwise_count(touching).sum()), int(np.bitwise_count(sticking).sum())


def _watched(
    slide: Slide, reference: Field, frames: list[MarkerFrame], truth: list[tuple[int, int, int]]
) -> WatchedSlide:
    detector = TouchDetector(reference)
    moved, touching = [], []
    for frame in frames:
        detector.update(frame)
        moved.append(detector.tracked_px)
        touching.append(detector.touching)
    t_us = np.array([frame.t_us for frame in frames], np.int64)
    share = _share_at(t_us, np.array(truth, np.int64))
    judged = _judged(share, _moving(slide, t_us))
    return WatchedSlide(
        slide, reference, t_us, np.array(moved), np.array(touching, np.bool_), share, judged
    )


def _share_at(t_us: Times, truth: Times) -> Field:
    """Return the sticking share of the last true row at each time."""
    rows = np.maximum(np.searchsorted(truth[:, 0], t_us, side="right") - 1, 0)
    touching, sticking = truth[rows, 1], truth[rows, 2]
    return np.where(touching >= LEAST_CELLS, sticking / np.maximum(touching, 1), np.nan)


def _moving(slide: Slide, t_us: Times) -> Flags:
    """Return whether the body moves or turns at each time."""
    timeline, step_s = Timeline(slide.scene, 0), 0.5 / RATE_HZ
    moving = np.zeros(len(t_us), np.bool_)
    for row, time_s in enumerate((t_us * 1e-6).tolist()):
        before, after = timeline.at(max(time_s - step_s, 0.0)), timeline.at(time_s + step_s)
        if before is None or after is None:
            continue
        shift = np.linalg.norm(after[1].position_mm - before[1].position_mm)
        turn = np.linalg.norm(after[1].rotation - before[1].rotation) / np.sqrt(2.0)
        moving[row] = shift + ARM_MM * turn > STILL_MM_S * 2.0 * step_s
    return moving


def _judged(share: Field, moving: Flags) -> Flags:
    has_share = np.isfinite(share)
    slipped = np.logical_or.accumulate(has_share & (np.nan_to_num(share) < HELD_SHARE))
    return has_share & (moving | ~slipped)
