"""The stream of the throughput bench: the skin moves on a circle, fast enough for 2 Mev/s."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim import (
    EventCamera,
    Optics,
    ReferenceHistory,
    SkinState,
    image_radius_px,
    load_scene,
)
from spikingtac.types import EventPacket
from spikingtac_paper.trials.ground_truth import GroundTruth
from spikingtac_paper.trials.trial import Trial

TARGET_HZ = 2.0e6
"""Events per second: a busy tactile recording (performance.md of the project's notes)."""

CIRCLE_MM = 0.33
"""Radius of the circle, mm: about 5 px."""

FIRST_GUESS_HZ = 4.0
"""Circles per second of the first trial; the rate of events grows with it."""

IMAGE_US = 1_000
"""Time between two images; the camera moves the markers linearly in between."""

TRY_US = 500_000
"""Length of a trial."""

TRIES = 2
"""Noise and dead time make the rate less than proportional: after one trial it is 5 % low."""


@dataclass(frozen=True, slots=True)
class BenchStream:
    """Events and truth of whole turns, so that the stream can be repeated without a jump.

    Attributes:
        events: All events, from time 0 on.
        truth: Where the markers were.
        rate_hz: Events per second.
        trial: Names sensor and camera, for the calibration.
    """

    events: EventPacket
    truth: GroundTruth
    rate_hz: float
    trial: Trial


def bench_stream(camera: str, seed: int, turns: int) -> BenchStream:
    """Return the stream of one camera preset.

    Args:
        camera: ``typical`` or ``noisy``.
        seed: Of the camera's noise.
        turns: Number of full circles.
    """
    trial = _trial(camera, seed)
    turns_hz = FIRST_GUESS_HZ
    for _ in range(TRIES):
        turns_hz *= TARGET_HZ / _shaken(trial, turns_hz, TRY_US).rate_hz
    turn_us = IMAGE_US * round(1e6 / turns_hz / IMAGE_US)
    return _shaken(trial, 1e6 / turn_us, turns * turn_us)


def _trial(camera: str, seed: int) -> Trial:
    return Trial(case=camera, scene="quiet", seed=seed, camera=camera)


def _shaken(trial: Trial, turns_hz: float, duration_us: int) -> BenchStream:
    scene = load_scene(trial.scene).with_camera(trial.camera).with_serial(trial.serial)
    optics = Optics(scene.optics, seed=scene.skin.serial)
    camera = EventCamera(scene.camera.resolve(scene.size), trial.seed, serial=scene.skin.serial)
    whole, truth = circling(
        (optics, camera), scene.history.references, scene.skin.at_rest(), turns_hz, duration_us
    )
    return BenchStream(whole, truth, len(whole) / (duration_us * 1e-6), trial)


def circling(
    sensor: tuple[Optics, EventCamera],
    references: ReferenceHistory,
    rest: SkinState,
    turns_hz: float,
    duration_us: int,
) -> tuple[EventPacket, GroundTruth]:
    """Return the events and the truth of a skin that moves on a circle as a whole.

    Args:
        sensor: Lens and camera.
        references: How the camera's pixels begin.
        rest: The skin at rest.
        turns_hz: Circles per second.
        duration_us: Length of the stream, us.
    """
    times_us = np.arange(0, duration_us + 1, IMAGE_US)
    angle = 2.0 * np.pi * turns_hz * 1e-6 * times_us
    # Leaves the rest smoothly: the circle passes through it.
    shift_mm = CIRCLE_MM * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    return shifted(sensor, references, rest, shift_mm)


def shifted(
    sensor: tuple[Optics, EventCamera],
    references: ReferenceHistory,
    rest: SkinState,
    shift_mm: NDArray[np.float64],
) -> tuple[EventPacket, GroundTruth]:
    """Return the events and the truth of a skin that moves as a whole.

    Args:
        sensor: Lens and camera.
        references: How the camera's pixels begin.
        rest: The skin at rest.
        shift_mm: ``(n, 2)`` how far it is moved along x and y every :data:`IMAGE_US`, mm.
    """
    optics, camera = sensor
    times_us = IMAGE_US * np.arange(len(shift_mm))
    way_mm = np.pad(shift_mm, ((0, 0), (0, 1)))
    images = [
        optics.project(replace(rest, t_us=t_us, marker_mm=rest.marker_mm + way))
        for t_us, way in zip(times_us.tolist(), way_mm, strict=True)
    ]
    camera.settle(images[0], references)
    events = EventPacket.concatenate([camera.advance([one]) for one in images[1:]])
    truth = GroundTruth(
        times_us.astype(np.int64),
        np.array([one.center_px for one in images]),
        images[0].center_px,
        image_radius_px(images[0]),
        int(times_us[-1]),
    )
    return events, truth
