"""A sensor as a camera: its image is the displacement field."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from lerobot.cameras.camera import Camera
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from numpy.typing import NDArray

import spikingtac as st
from lerobot_camera_spikingtac.config_camera import SpikingTacCameraConfig
from lerobot_camera_spikingtac.field_image import field_image
from spikingtac.stream.sensor import LiveFrame

NAME = "sensor"
START_S = 30.0  # Longest wait for the first frame, s: kernels may have to be compiled.
LOOK_S = 0.001
NS_PER_MS = 1_000_000


class SpikingTacCamera(Camera):
    """Follows a sensor in a process of its own and gives its latest field as an image.

    Args:
        config: Which sensor, and how it is drawn.
    """

    def __init__(self, config: SpikingTacCameraConfig) -> None:
        super().__init__(config)
        self.config = config
        self._calibration = st.Calibration.load(config.calibration)
        self._hand: st.Hand | None = None
        self._taken = 0
        self._force: Any = None

    @property
    def is_connected(self) -> bool:
        """Whether the sensor is followed."""
        return self._hand is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Return the event cameras that are plugged in."""
        from spikingtac.cameras.libraries import plugged_in

        return [
            {"type": "spikingtac", "name": camera.model, "id": camera.address}
            for camera in plugged_in()
            if camera.address
        ]

    def connect(self, warmup: bool = True) -> None:
        """Start to follow the sensor, and wait for its first frame where ``warmup`` says so.

        Raises:
            DeviceAlreadyConnectedError: It is followed already.
            ConnectionError: It fails; says why.
        """
        if self._hand is not None:
            raise DeviceAlreadyConnectedError(f"{self.config.source} is connected")
        config = st.load_config(self.config.preset).with_tracking(rate_hz=self.config.rate_hz)
        finger = st.Finger(
            source=self.config.source,
            calibration=self.config.calibration,
            tracking=config.tracking,
        )
        self._hand, self._taken = st.Hand({NAME: finger}), 0
        if self.config.force is not None:
            from spikingtac.touch.force.model import load_force

            self._force = load_force(self.config.force).estimator()
        if warmup:
            try:
                self._next(START_S)
            except BaseException:
                self.disconnect()
                raise

    def read(self, color_mode: Any = None) -> NDArray[Any]:
        """Return the image of the next frame."""
        return self.async_read(1e3 * START_S)

    def async_read(self, timeout_ms: float = 200) -> NDArray[Any]:
        """Return the image of a frame that was not returned yet, waiting for it if necessary.

        Raises:
            TimeoutError: None came in time.
            ConnectionError: The sensor has failed or ended.
        """
        return self._image(self._next(timeout_ms * 1e-3))

    def read_latest(self, max_age_ms: int = 500) -> NDArray[Any]:
        """Return the image of the latest frame at once.

        Raises:
            TimeoutError: It is older than that.
            RuntimeError: There is none yet.
        """
        return self._image(self._latest(max_age_ms))

    def read_displacement(self, max_age_ms: int = 500) -> NDArray[np.float32]:
        """Return the latest displacements ``(m, 2)``, px; raises as :meth:`read_latest`."""
        return self._latest(max_age_ms).displacement_px

    def read_wrench(self, max_age_ms: int = 500) -> NDArray[np.float64]:
        """Return forces in N, then moments in Nm, of the latest frame; needs ``force``.

        Raises:
            RuntimeError: No force model was given.
        """
        if self._force is None:
            raise RuntimeError("no force model; give force=force.onnx in the camera's settings")
        reading = self._latest(max_age_ms)
        return self._force.update(reading.t_us, reading.displacement_px.astype(np.float64)).values

    def disconnect(self) -> None:
        """Stop to follow the sensor.

        Raises:
            DeviceNotConnectedError: It is not followed.
        """
        self._followed().close()
        self._hand = None

    def _followed(self) -> st.Hand:
        if self._hand is None:
            raise DeviceNotConnectedError(f"{self.config.source} is not connected")
        return self._hand

    def _next(self, timeout_s: float) -> LiveFrame:
        hand, deadline_s = self._followed(), time.monotonic() + timeout_s
        while True:
            reading = hand.latest()[NAME]
            if reading is not None and reading.number > self._taken:
                self._taken = reading.number
                return reading
            health = hand.health()[NAME]
            if health.state not in ("starting", "running"):
                raise ConnectionError(f"{self.config.source}: {health.state} {health.why}".strip())
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"{self.config.source} gave no new frame in {timeout_s:g} s")
            time.sleep(LOOK_S)

    def _latest(self, max_age_ms: int) -> LiveFrame:
        reading = self._followed().latest()[NAME]
        if reading is None:
            raise RuntimeError(f"{self.config.source} has given no frame yet")
        age_ms = (time.monotonic_ns() - reading.told_ns) / NS_PER_MS
        if age_ms > max_age_ms:
            raise TimeoutError(f"the latest frame of {self.config.source} is {age_ms:.0f} ms old")
        return reading

    def _image(self, reading: LiveFrame) -> NDArray[np.uint8]:
        return field_image(
            reading.displacement_px,
            reading.coasted,
            self._calibration.grid,
            self.config.range_px,
            self.config.cell_px,
        )
