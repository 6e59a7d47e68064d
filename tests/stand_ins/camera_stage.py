"""Four discs before a small camera: what the tests of the camera film."""

import math
from dataclasses import replace

import numpy as np

from spikingtac.sim.camera.config import BackgroundConfig, load_camera
from spikingtac.sim.camera.event_camera import EventCamera
from spikingtac.sim.optics import MarkerImage
from spikingtac.types import EventPacket

SIZE = (128, 128)
PERIOD_US = 2000
RADIUS_PX = 7.0
STROKE_PX = 14.0
CENTERS = np.array([[40.2, 40.1], [80.3, 40.4], [40.2, 80.7], [80.1, 80.2]])


def image(t_us, shift=(0.0, 0.0), centers=CENTERS) -> MarkerImage:
    """Return whole discs that nothing deforms."""
    shape, radius_px = np.tile(np.eye(2), (len(centers), 1, 1)), np.full(len(centers), RADIUS_PX)
    return MarkerImage(int(t_us), centers + np.asarray(shift), shape, radius_px)


def strokes(speed_px_s: float, travel_px: float) -> list[MarkerImage]:
    """Move to and fro at a steady speed."""
    period_us = PERIOD_US if speed_px_s < 500 else PERIOD_US // 10  # images must catch the turns
    count = round(travel_px / speed_px_s * 1e6 / period_us)
    way = speed_px_s * np.arange(count + 1) * period_us * 1e-6
    place = STROKE_PX - np.abs(way % (2 * STROKE_PX) - STROKE_PX)
    angled = np.stack([place, 0.3 * place], axis=1) / math.hypot(1, 0.3)
    return [image(k * period_us, shift) for k, shift in enumerate(angled)]


def camera(name="clean", contrast=6.0, **pixel) -> EventCamera:
    """Return a small sensor without background and leak."""
    config = replace(load_camera(name), background=BackgroundConfig())
    light = replace(config.light, contrast=contrast)
    changed = replace(config.pixel, leak_hz=0.0, **pixel)
    return EventCamera(replace(config, light=light, pixel=changed), SIZE, seed=1)


def film(sensor: EventCamera, images, history="random") -> EventPacket:
    sensor.settle(images[0], history)
    return sensor.advance(images[1:])
