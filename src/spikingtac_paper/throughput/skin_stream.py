"""Streams of big skins: all markers move on a circle, as fast as a rate of events needs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.sim.camera.camera import EventCamera, ReferenceHistory
from spikingtac.sim.optics import Optics
from spikingtac.sim.scene import catalog
from spikingtac.sim.states import SkinState
from spikingtac.types import EventPacket
from spikingtac_paper.throughput.bench_stream import (
    IMAGE_US,
    BenchStream,
    circling,
    shifted,
)
from spikingtac_paper.trials.ground_truth import GroundTruth
from spikingtac_paper.trials.trials import Trial

FAR_MM = 200.0
"""Distance of the lens: a wide skin is seen without distortion, so that all its markers are alike
(ours)."""

TRY_US = 50_000
"""Length of a trial, from which the speed for the wanted rate follows."""

TRIES = 2
"""The rate grows less than the speed; after two trials it is within some per cent."""

SLIDE_PX, SLIDE_US, REST_US = 8.0, 600_000, 400_000
"""Length of a slide to and fro, its duration, and the rests between slides (ours)."""

SLIDES = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (0.7, 0.7), (-0.7, -0.7))
"""Directions of the slides."""

FIRST_TURNS_HZ = 2.0
"""Circles per second of the first trial, for 64 markers and 1 Mev/s."""


@dataclass(frozen=True, slots=True)
class Skin:
    """A skin and its sensor.

    Attributes:
        grid: ``(rows, columns)`` of markers.
        size: ``(width, height)`` of the sensor, px.
        px_per_mm: Scale of the image; the markers' pitch is 2.4 mm.
        radius_mm: Radius of the discs.
    """

    grid: tuple[int, int]
    size: tuple[int, int]
    px_per_mm: float
    radius_mm: float

    @property
    def count(self) -> int:
        """Number of markers."""
        return self.grid[0] * self.grid[1]


SKINS = (
    Skin((8, 8), (320, 320), 15.5, 0.45),
    Skin((16, 16), (640, 640), 15.5, 0.45),
    # The sensor's height allows a pitch of 22 px; discs of 6 px leave 10 px between them.
    Skin((32, 32), (1280, 720), 9.2, 0.65),
)


def skin_stream(skin: Skin, rate_mev_s: float, seed: int, duration_us: int) -> BenchStream:
    """Simulate a skin in motion, with the camera preset ``typical`` but no cap of its readout.

    Args:
        skin: Which one.
        rate_mev_s: Wanted events, million per second.
        seed: Of the camera's noise.
        duration_us: Length, us.
    """
    turns_hz = FIRST_TURNS_HZ * rate_mev_s * SKINS[0].count / skin.count
    for _ in range(TRIES):
        turns_hz *= rate_mev_s * 1e6 / _moved(skin, turns_hz, seed, TRY_US).rate_hz
    return _moved(skin, turns_hz, seed, duration_us)


def calibration_at_rest(skin: Skin, stream: BenchStream) -> Calibration:
    """Return the calibration of a stream's skin, from its truth."""
    return Calibration(
        reference_px=stream.truth.reference_px,
        radius_px=stream.truth.radius_px,
        grid=skin.grid,
        size=skin.size,
        provenance={"from": "the twin's truth at rest"},
    )


def slides(skin: Skin, seed: int) -> BenchStream:
    """Simulate slides to and fro in six directions, from which a skin can be calibrated.

    Args:
        skin: Which one.
        seed: Of the camera's noise.
    """
    length_mm = SLIDE_PX / skin.px_per_mm
    share = np.sin(np.linspace(0.0, np.pi, SLIDE_US // IMAGE_US, endpoint=False)) ** 2
    rest = np.zeros((REST_US // IMAGE_US, 2))
    parts = [rest]
    for way in SLIDES:
        parts += [length_mm * share[:, np.newaxis] * np.array(way), rest]
    shift_mm = np.concatenate(parts)
    sensor, references, still = _sensor(skin, seed)
    return _stream(*shifted(sensor, references, still, shift_mm), seed)


def _moved(skin: Skin, turns_hz: float, seed: int, duration_us: int) -> BenchStream:
    sensor, references, rest = _sensor(skin, seed)
    return _stream(*circling(sensor, references, rest, turns_hz, duration_us), seed)


def _stream(events: EventPacket, truth: GroundTruth, seed: int) -> BenchStream:
    trial = Trial(case="skin", scene="quiet", seed=seed, camera="typical")
    return BenchStream(
        events, truth, len(events) / ((events.t_end_us - events.t_start_us) * 1e-6), trial
    )


def _sensor(
    skin: Skin, seed: int
) -> tuple[tuple[Optics, EventCamera], ReferenceHistory, SkinState]:
    scene = catalog.load("quiet")
    discs = replace(scene.optics.discs, radius_mm=skin.radius_mm)
    optics = Optics(
        replace(
            scene.optics,
            size=skin.size,
            px_per_mm=skin.px_per_mm,
            distance_mm=FAR_MM,
            k1=0.0,
            discs=discs,
        ),
        seed=scene.skin.serial,
    )
    settings = scene.camera.resolve(skin.size)
    settings = replace(settings, readout=replace(settings.readout, cap_mev_s=None))
    camera = EventCamera(settings, seed, serial=scene.skin.serial)
    rest = replace(scene.skin, grid=skin.grid).at_rest()
    return (optics, camera), scene.history.references, rest
