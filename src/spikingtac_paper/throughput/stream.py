"""Streams of the benches: the skin moves on a circle, as fast as a rate of events asks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spikingtac.sim import EventCamera, Optics, Scene, image_radius_px, load_scene
from spikingtac.types import EventPacket
from spikingtac_paper.trials.trajectories import GroundTruth

TARGET_HZ = 2.0e6  # Events per second of the throughput bench: a busy tactile recording.
CIRCLE_MM = 0.33  # Radius of the circle, mm: about 5 px.
FIRST_GUESS_HZ = 4.0  # Circles per second of the first trial; the rate of events grows with it.
IMAGE_US = 1_000  # Time between two images, us; the camera moves the markers linearly in between.
TRY_US = 500_000  # Length of a trial, us.

# Noise and dead time make the rate less than proportional: after one trial it is 5 % low.
TRIES = 2


@dataclass(frozen=True, slots=True)
class BenchStream:
    """Events and truth of a skin that moves on a circle.

    Attributes:
        events: All events, from time 0 on.
        truth: Where the markers were.
        rate_hz: Events per second.
    """

    events: EventPacket
    truth: GroundTruth
    rate_hz: float


def bench_stream(camera: str, seed: int, turns: int) -> BenchStream:
    """Return whole turns of the default skin, so that they can be repeated without a jump.

    Args:
        camera: ``typical`` or ``noisy``.
        seed: Of the camera's noise.
        turns: Number of full circles.
    """
    scene = load_scene("quiet").with_camera(camera).with_serial(1)
    turns_hz = turns_for(scene, seed, TARGET_HZ, FIRST_GUESS_HZ, TRY_US)
    turn_us = IMAGE_US * round(1e6 / turns_hz / IMAGE_US)
    return circling(scene, seed, 1e6 / turn_us, turns * turn_us)


def turns_for(
    scene: Scene, seed: int, rate_hz: float, turns_hz: float, try_us: int, capped: bool = True
) -> float:
    """Return the circles per second that give a rate of events, from a first guess of them."""
    for _ in range(TRIES):
        turns_hz *= rate_hz / circling(scene, seed, turns_hz, try_us, capped).rate_hz
    return turns_hz


def circling(
    scene: Scene, seed: int, turns_hz: float, duration_us: int, capped: bool = True
) -> BenchStream:
    """Return the events and the truth of a scene's skin that moves on a circle as a whole.

    Args:
        scene: The sensor; its contacts are left out.
        seed: Of the camera's noise.
        turns_hz: Circles per second.
        duration_us: Length of the stream, us.
        capped: Whether the camera's readout has its largest rate.
    """
    serial, settings = scene.skin.serial, scene.camera.resolve(scene.size)
    if not capped:
        settings = replace(settings, readout=replace(settings.readout, cap_mev_s=None))
    optics, camera = Optics(scene.optics, seed=serial), EventCamera(settings, seed, serial=serial)
    times_us = np.arange(0, duration_us + 1, IMAGE_US)
    angle = 2.0 * np.pi * turns_hz * 1e-6 * times_us
    # Leaves the rest smoothly: the circle passes through it.
    way_mm = CIRCLE_MM * np.column_stack([np.sin(angle), 1.0 - np.cos(angle), 0.0 * angle])
    rest = scene.skin.at_rest()
    images = [
        optics.project(replace(rest, t_us=t_us, marker_mm=rest.marker_mm + way))
        for t_us, way in zip(times_us.tolist(), way_mm, strict=True)
    ]
    camera.settle(images[0], scene.history.references)
    events = EventPacket.concatenate([camera.advance([one]) for one in images[1:]])
    centers_px = np.array([one.center_px for one in images])
    truth = GroundTruth(
        times_us, centers_px, centers_px[0], image_radius_px(images[0]), int(times_us[-1])
    )
    return BenchStream(events, truth, len(events) / (duration_us * 1e-6))
