"""The simulated event camera. It turns images of moving markers into events."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim.camera.config import CameraConfig
from spikingtac.sim.camera.coverage import (
    DISC_DTYPE,
    SWEEP_PLAN_DTYPE,
    coverage_image_kernel,
    discs_of,
    plan_sweep,
    set_boxes,
    swept_pixel_count,
)
from spikingtac.sim.camera.full_frame import FullFrameRenderer
from spikingtac.sim.camera.readout import Readout, background_events_kernel, make_noise, start_noise
from spikingtac.sim.camera.sensor import make_sensor, settle_sensor, texture_field
from spikingtac.sim.camera.sweep import MarkerSweep, sweep_kernel
from spikingtac.sim.states import MarkerImage
from spikingtac.types import EventPacket, LossCounters

# State of the pixels' reference levels at the start; see :meth:`EventCamera.settle`.
ReferenceHistory = Literal["rested", "random", "fresh"]

_INITIAL_OUTBOX = 1 << 16  # Initial capacity of the event buffer, events.

# Upper bound of how often the light of a pixel crosses its whole range between two images.
_MAX_LIGHT_SWINGS = 4


class EventCamera:
    """Renders marker motions into events. Each pixel keeps its state between calls.

    Only pixels near a moving edge are computed step by step. The state of all others is advanced in
    closed form. The result depends on the seed and on the images, not on how the images are grouped
    into calls. A copy made with :func:`copy.deepcopy` continues independently from the same state.

    Args:
        config: Settings of the sensor.
        seed: Seed of the noise, and of the individual sensor if ``serial`` is None.
        serial: Number of the individual sensor. It fixes threshold mismatch, hot pixels and ground
            pattern for every seed.

    Attributes:
        size: ``(width, height)``, px.
        losses: Number of events that the readout dropped, by kind.
    """

    def __init__(self, config: CameraConfig, seed: int = 0, serial: int | None = None) -> None:
        noise_streams = np.random.default_rng(seed).spawn(5)
        sensor_streams = noise_streams if serial is None else np.random.default_rng(serial).spawn(5)
        self.size = config.size
        self.losses = LossCounters()
        self._config = config
        self._rng = noise_streams[3]
        pattern = texture_field(config.light, sensor_streams[4])
        self._sensor = make_sensor(config, pattern, sensor_streams[0])
        light = config.light
        moving = light.texture > 0 and light.texture_follow != 0
        self._full_frame = FullFrameRenderer(config, pattern) if moving else None
        self._noise = make_noise(
            config.background, config.size[0] * config.size[1], sensor_streams[1]
        )
        if serial is not None:  # the same pixels, but not the same noise in every recording
            self._sensor.chip["key"] = noise_streams[0].integers(0, 1 << 63)
            self._noise = self._noise._replace(key=np.uint64(noise_streams[1].integers(0, 1 << 63)))
        self._readout = Readout(config.readout, config.size, noise_streams[2], self.losses)
        self._out = np.zeros(_INITIAL_OUTBOX, np.int64)
        self._discs = np.empty(0, DISC_DTYPE)
        self._t_us: int | None = None
        pixels = self._sensor.pixels
        lowest = float(min(pixels["threshold_on"].min(), pixels["threshold_off"].min()))
        log = self._sensor.chip["log_intensity"]
        self._max_crossings = 1 + int(float(log.max() - log.min()) / lowest)
        self._fastest_leak = float(pixels["mean_leak_per_us"].max()) / lowest

    @property
    def t_us(self) -> int | None:
        """Time up to which events have been returned, us; None before :meth:`settle`."""
        return self._t_us

    def settle(self, image: MarkerImage, history: ReferenceHistory = "rested") -> None:
        """Set every pixel to its steady state under a still image. Time starts at the image's time.

        Args:
            image: Image of the markers at rest.
            history: Initial reference levels. ``rested``: the leak has moved each reference by a
                random part of a threshold, as after minutes without motion. ``random``: earlier
                motions have left each reference anywhere between its thresholds. ``fresh``: each
                reference equals the present level, which no real sensor shows.
        """
        self._discs = discs_of(image)
        coverage = self._coverage_image(self._discs)
        settle_sensor(self._sensor, coverage, float(image.t_us), history, self._rng)
        if self._full_frame is not None:
            self._full_frame.settle(self._discs)
        self._readout.reset(int(image.t_us))
        start_noise(self._noise, float(image.t_us))
        self._t_us = int(image.t_us)

    def advance(self, images: Sequence[MarkerImage]) -> EventPacket:
        """Return the events from the present time to the time of the last image.

        Args:
            images: Images in order of time. The markers move evenly from each image to the next. A
                first image at the present time repeats the last one and is skipped.

        Returns:
            The events, and the span from the present time to the last image.

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
            parts.append(self._render_interval(image))
        assert self._t_us is not None
        return self._readout.packet(parts, start_us, self._t_us)

    def _render_interval(self, image: MarkerImage) -> NDArray[np.int64]:
        start_us = self._checked(image)
        after, end_us = discs_of(image), int(image.t_us)
        reach_px = float(self._sensor.chip["edge_half_width_px"][0])
        span_us = float(end_us) - float(start_us)
        plan = plan_sweep(self._discs, after, reach_px, span_us, self._config.steps)
        sweep = MarkerSweep(
            self._discs, after, np.empty_like(after), plan, float(start_us), float(end_us)
        )
        self._reserve_outbox(swept_pixel_count(plan, *self.size), span_us)
        if self._full_frame is None:
            sweep_kernel(self._sensor, sweep, self._out)
        else:
            self._full_frame.render(self._sensor, sweep, self._out, self._drain)
        while not background_events_kernel(self._noise, sweep.end_us, self._out):
            self._drain()
        self._drain()
        self._t_us = end_us
        return self._readout.release(end_us)

    def _checked(self, image: MarkerImage) -> int:
        if len(image.radius_px) != len(self._discs):
            raise ValueError(
                f"the image has {len(image.radius_px)} markers, the one before had "
                f"{len(self._discs)}; give missing markers the radius 0"
            )
        if self._t_us is None or image.t_us <= self._t_us:
            raise ValueError(f"the image's time {image.t_us} us is not after {self._t_us} us")
        return self._t_us

    def _reserve_outbox(self, swept: int, span_us: float) -> None:
        """Enlarge the outbox so that it holds the largest number of events of the next interval."""
        pixels = self._sensor.pixels.size
        leaks = 2 + int(4 * self._fastest_leak * span_us)
        moving = swept + int(self._sensor.pending.unsettled_count[0])
        if self._full_frame is not None:
            moving = pixels
        room = 1 + moving * _MAX_LIGHT_SWINGS * self._max_crossings + pixels * leaks
        if room > len(self._out):
            self._out = np.zeros(2 * room, np.int64)

    def _drain(self) -> None:
        count = int(self._out[0])
        if count >= len(self._out):
            raise RuntimeError("more events than a motion can cause; please report this scene")
        self._readout.collect(self._out[1 : 1 + count])
        self._out[0] = 0

    def _coverage_image(self, discs: NDArray[Any]) -> NDArray[np.float32]:
        width, height = self.size
        coverage = np.empty((height, width), np.float32)
        chip = self._sensor.chip[0]
        boxes = np.zeros(len(discs), SWEEP_PLAN_DTYPE)
        set_boxes(boxes, discs, discs, float(chip["edge_half_width_px"]) + 1.0)
        coverage_image_kernel(discs, boxes, chip, coverage)
        return coverage
