"""The simulated event camera. It turns images of moving markers into events."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim.camera import coverage, readout, sensor, sweep
from spikingtac.sim.camera.config import CameraConfig
from spikingtac.sim.optics import MarkerImage
from spikingtac.types import EventPacket

# State of the pixels' reference levels at the start; see :meth:`EventCamera.settle`.
ReferenceHistory = Literal["rested", "random", "fresh"]

_INITIAL_OUTBOX = 1 << 16  # Initial capacity of the event buffer, events.

# Longest step of a moving marker, us, in which the light moves evenly. Against 2 ms the number of
# events changes by less than 1e-5 in `finger-presses` and `comb-slides`.
MAX_STEP_US = 4000.0
STILL_PX = 0.001  # Motion of a marker up to which it is not rendered again, px.

# Upper bound of how often the light of a pixel crosses its whole range between two images.
_MAX_LIGHT_SWINGS = 4


class EventCamera:
    """Renders marker motions into events. Each pixel keeps its state between calls.

    Only pixels near a moving edge are computed step by step. The state of all others is advanced in
    closed form. The result depends on the seed and on the images, not on how the images are grouped
    into calls. A copy made with :func:`copy.deepcopy` continues independently from the same state.

    Args:
        config: Settings of the sensor.
        size: ``(width, height)``, px.
        seed: Seed of the noise, and of the individual sensor if ``serial`` is None.
        serial: Number of the individual sensor. It fixes threshold mismatch, hot pixels and texture
            for every seed.
        still_px: Motion of a marker up to which it is not rendered again, px.

    Attributes:
        size: ``(width, height)``, px.
        losses: Number of events that the readout dropped, by kind.
    """

    def __init__(
        self,
        config: CameraConfig,
        size: tuple[int, int],
        seed: int = 0,
        serial: int | None = None,
        still_px: float = STILL_PX,
    ) -> None:
        noise_streams = np.random.default_rng(seed).spawn(4)
        sensor_streams = noise_streams if serial is None else np.random.default_rng(serial).spawn(4)
        self.size, self._limits, self._rng = size, (MAX_STEP_US, still_px), noise_streams[3]
        self._sensor = sensor.make_sensor(config, size, sensor_streams[0])
        pixels, log = self._sensor.pixels, self._sensor.chip["log_intensity"]
        self._noise = readout.make_noise(config.background, pixels.size, sensor_streams[1])
        if serial is not None:  # the same pixels, but not the same noise in every recording
            self._sensor.chip["key"] = noise_streams[0].integers(0, 1 << 63)
            self._noise = self._noise._replace(key=np.uint64(noise_streams[1].integers(0, 1 << 63)))
        loss_key = int(noise_streams[2].integers(0, 1 << 63))
        self._readout = readout.Readout(config.readout, size, loss_key)
        self.losses = self._readout.losses
        self._out = np.zeros(_INITIAL_OUTBOX, np.int64)
        self._discs = np.empty(0, coverage.DISC_DTYPE)
        self._t_us: int | None = None  # up to which events have been returned
        lowest = float(min(pixels["threshold_on"].min(), pixels["threshold_off"].min()))
        self._max_crossings = 1 + int(float(log.max() - log.min()) / lowest)
        self._fastest_leak = float(pixels["mean_leak_per_us"].max()) / lowest

    def settle(self, image: MarkerImage, history: ReferenceHistory = "rested") -> None:
        """Set every pixel to its steady state under a still image. Time starts at the image's time.

        Args:
            image: Image of the markers at rest.
            history: Initial reference levels. ``rested``: the leak has moved each reference by a
                random part of a threshold, as after minutes without motion. ``random``: earlier
                motions have left each reference anywhere between its thresholds. ``fresh``: each
                reference equals the present level, which no real sensor shows.
        """
        self._discs = coverage.discs_of(image)
        self._plan = np.zeros(len(self._discs), coverage.SWEEP_PLAN_DTYPE)
        covered = np.empty(self.size[::-1], np.float32)
        coverage.coverage_image_kernel(self._discs, self._sensor.chip[0], covered)
        self._t_us = int(image.t_us)
        sensor.settle_sensor(self._sensor, covered, float(self._t_us), history, self._rng)
        self._readout.reset(self._t_us)
        readout.start_noise(self._noise, float(self._t_us))

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
        if self._t_us is None:
            raise ValueError("the camera has no image yet; call settle(image) first")
        start_us = end_us = self._t_us
        parts: list[NDArray[np.int64]] = []
        for number, image in enumerate(images):
            if number or image.t_us != start_us:
                parts.append(self._render_interval(image, end_us))
            self._t_us = end_us = int(image.t_us)
        return self._readout.packet(parts, start_us, end_us)

    def _render_interval(self, image: MarkerImage, start_us: int) -> NDArray[np.int64]:
        if len(image.radius_px) != len(self._discs):
            raise ValueError(
                f"the image has {len(image.radius_px)} markers, the one before had "
                f"{len(self._discs)}; give missing markers the radius 0"
            )
        if image.t_us <= start_us:
            raise ValueError(f"the image's time {image.t_us} us is not after {start_us} us")
        after, end_us = coverage.discs_of(image), int(image.t_us)
        moved = sweep.MarkerSweep(
            self._discs, after, np.empty_like(after), self._plan, float(start_us), float(end_us)
        )
        # The outbox holds the most events that all pixels can emit in the interval. The system
        # gives memory to the pages that are written, which are few.
        leaks = 2 + int(4 * self._fastest_leak * float(end_us - start_us))
        most = self._sensor.pixels.size * (_MAX_LIGHT_SWINGS * self._max_crossings + leaks)
        if most >= len(self._out):
            self._out = np.zeros(1 + 2 * most, np.int64)
        sweep.sweep_kernel(self._sensor, moved, self._limits, self._out)
        while not readout.background_events_kernel(self._noise, moved.end_us, self._out):
            self._drain()
        self._drain()
        return self._readout.release(end_us)

    def _drain(self) -> None:
        count = int(self._out[0])
        if count >= len(self._out):
            raise RuntimeError("more events than a motion can cause; please report this scene")
        self._readout.collect(self._out[1 : 1 + count])
        self._out[0] = 0
