"""The twin's event camera: images of markers in, events out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim.camera.config import CameraConfig
from spikingtac.sim.camera.full_frame import DenseRenderer, is_dense
from spikingtac.sim.camera.light import texture_field
from spikingtac.sim.camera.noise import make_noise, noise_kernel, start_noise
from spikingtac.sim.camera.pixel_coverage import DISC_DTYPE, discs_of, paint_kernel
from spikingtac.sim.camera.readout import Readout
from spikingtac.sim.camera.sensor import make_sensor, settle_sensor
from spikingtac.sim.camera.sweep import Motion, sweep_kernel
from spikingtac.sim.camera.sweep_plan import WORK_DTYPE, box_kernel, plan_kernel, swept_kernel
from spikingtac.sim.optics.states import MarkerImage
from spikingtac.types import EventPacket, LossCounters

TrackerHistory = Literal["rested", "random", "fresh"]
"""What the references remember: a long rest, arbitrary past motions, or nothing at all."""

_FIRST_OUTBOX = 1 << 16
_PASSES = 4
"""Upper bound of how often a pixel's light crosses its whole range between two images."""


class EventCamera:
    """Renders marker motions into events; its pixels remember everything that they saw.

    Only pixels near a moving edge are computed step by step; the others are carried in closed form.
    The result depends on the seed and on the images, not on how the images are grouped into calls.
    Copies made with :func:`copy.deepcopy` go on independently from the same state.

    Args:
        config: The sensor.
        seed: Of the noise, and of the sensor where no serial is given.
        serial: Which sensor: its mismatch, hot pixels and ground pattern, whatever the seed.

    Attributes:
        size: ``(width, height)``, px.
        losses: Events dropped by the readout, by kind.
    """

    def __init__(self, config: CameraConfig, seed: int = 0, serial: int | None = None) -> None:
        streams = np.random.default_rng(seed).spawn(6)
        made = streams if serial is None else np.random.default_rng(serial).spawn(6)
        self.size = config.size
        self.losses = LossCounters()
        self._config = config
        self._rng = streams[3]
        pattern = texture_field(config.light, made[4])
        self._sensor = make_sensor(config, pattern, made[0])
        self._dense = DenseRenderer(config, pattern, streams[5]) if is_dense(config) else None
        self._noise = make_noise(config.background, config.size[0] * config.size[1], made[1])
        if serial is not None:  # the same pixels, but not the same noise in every recording
            self._sensor.chip["key"] = streams[0].integers(0, 1 << 63)
            self._noise = self._noise._replace(key=np.uint64(streams[1].integers(0, 1 << 63)))
        self._readout = Readout(config.readout, config.size, streams[2], self.losses)
        self._out = np.zeros(_FIRST_OUTBOX, np.int64)
        self._before = np.empty(0, DISC_DTYPE)
        self._t_us: int | None = None
        steps = config.steps
        pixels = self._sensor.pixels
        lowest, log = float(min(pixels["on"].min(), pixels["off"].min())), self._sensor.chip["log"]
        self._most_crossings = 1 + int(float(log.max() - log.min()) / lowest)
        self._fastest_leak = float(pixels["mean_leak"].max()) / lowest
        self._limits = (steps.motion_px, steps.min_us, steps.max_us, steps.still_px)

    @property
    def t_us(self) -> int | None:
        """Time up to which events were given out, us; None before :meth:`settle`."""
        return self._t_us

    def settle(self, image: MarkerImage, history: TrackerHistory = "rested") -> None:
        """Look at a still image until every pixel is quiet; time starts at the image's.

        Args:
            image: The markers.
            history: ``rested``: the leak has moved each reference by an unknown part of a
                threshold, as after minutes without motion; ``random``: past motions left each
                anywhere between its thresholds; ``fresh``: each is exact, as no real sensor's are.
        """
        self._before = discs_of(image)
        coverage = self._paint(self._before)
        settle_sensor(self._sensor, coverage, float(image.t_us), history, self._rng)
        if self._dense is not None:
            self._dense.settle(self._before, float(image.t_us))
        self._readout.reset(int(image.t_us))
        start_noise(self._noise, float(image.t_us))
        self._t_us = int(image.t_us)

    def advance(self, images: Sequence[MarkerImage]) -> EventPacket:
        """Return the events from the present time to the last image's.

        Args:
            images: In order of time; the markers move evenly from each to the next. A first one at
                the present time repeats the last one given, and is passed over.

        Raises:
            ValueError: :meth:`settle` was not called, the times do not increase, or the number of
                markers changed.
        """
        start_us = self._t_us
        if start_us is None:
            raise ValueError("the camera has no image yet; call settle(image) first")
        parts: list[NDArray[np.int64]] = []
        for number, image in enumerate(images):
            if number == 0 and image.t_us == self._t_us:
                continue
            parts.append(self._interval(image))
        assert self._t_us is not None
        return self._readout.packet(parts, start_us, self._t_us)

    def _interval(self, image: MarkerImage) -> NDArray[np.int64]:
        start_us = self._checked(image)
        after = discs_of(image)
        work = np.empty(len(after), WORK_DTYPE)
        end_us = int(image.t_us)
        motion = Motion(
            self._before, after, np.empty_like(after), work, float(start_us), float(end_us)
        )
        reach_px = float(self._sensor.chip["reach_px"][0])
        span_us = motion.end_us - motion.start_us
        plan_kernel(self._before, after, work, reach_px, span_us, self._limits)
        self._make_room(swept_kernel(work, *self.size), span_us)
        if self._dense is None:
            sweep_kernel(self._sensor, motion, self._out)
        else:
            self._dense.render(self._sensor, motion, self._out, self._drain)
        while not noise_kernel(self._noise, motion.end_us, self._out):
            self._drain()
        self._drain()
        self._t_us = end_us
        return self._readout.release(end_us)

    def _checked(self, image: MarkerImage) -> int:
        if len(image.radius_px) != len(self._before):
            raise ValueError(
                f"the image has {len(image.radius_px)} markers, the one before had "
                f"{len(self._before)}; give missing markers the radius 0"
            )
        if self._t_us is None or image.t_us <= self._t_us:
            raise ValueError(f"the image's time {image.t_us} us is not after {self._t_us} us")
        return self._t_us

    def _make_room(self, swept: int, span_us: float) -> None:
        """Enlarge the outbox to hold whatever the next interval can bring."""
        pixels = self._sensor.pixels.size
        leaks = 2 + int(4 * self._fastest_leak * span_us)
        moving = swept + int(self._sensor.agenda.listed[0])
        if self._dense is not None:
            moving = pixels
        room = 1 + moving * _PASSES * self._most_crossings + pixels * leaks
        if room > len(self._out):
            self._out = np.zeros(2 * room, np.int64)

    def _drain(self) -> None:
        count = int(self._out[0])
        if count >= len(self._out):
            raise RuntimeError("more events than a motion can cause; please report this scene")
        self._readout.collect(self._out[1 : 1 + count])
        self._out[0] = 0

    def _paint(self, discs: NDArray[Any]) -> NDArray[np.float32]:
        width, height = self.size
        coverage = np.empty((height, width), np.float32)
        chip = self._sensor.chip[0]
        boxes = np.zeros(len(discs), WORK_DTYPE)
        for disc, box in zip(discs, boxes, strict=True):
            box_kernel(disc, disc, float(chip["reach_px"]) + 1.0, box)
        paint_kernel(discs, boxes, chip, coverage)
        return coverage
