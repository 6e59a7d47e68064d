"""A sensor as a camera: its image is the displacement field."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from lerobot.cameras.camera import Camera
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from numpy.typing import NDArray

import spikingtac as st
from lerobot_camera_spikingtac.config_camera import CELL_PX, RANGE_PX, SpikingTacCameraConfig
from lerobot_camera_spikingtac.field_image import field_image

START_S = 30.0  # Longest wait for the first frame, s: kernels may have to be compiled.
LOOK_S = 0.001  # Time between two looks for a new frame, s.


class SpikingTacCamera(Camera):
    """Follows a sensor in a process of its own and gives its latest field as an image.

    Args:
        config: Which sensor.
    """

    def __init__(self, config: SpikingTacCameraConfig) -> None:
        super().__init__(config)
        self.config = config
        self._calibration = st.Calibration.load(config.calibration)
        self._live: st.Live | None = None
        self._taken = 0
        self._force: Any = None

    @property
    def is_connected(self) -> bool:
        """Whether the sensor is followed."""
        return self._live is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Return the event cameras that are plugged in."""
        from spikingtac.cameras.libraries import plugged_in

        found = [camera for camera in plugged_in() if camera.address]
        return [{"type": "spikingtac", "name": one.model, "id": one.address} for one in found]

    def connect(self, warmup: bool = True) -> None:
        """Start to follow the sensor, and wait for its first frame where ``warmup`` says so.

        Raises:
            DeviceAlreadyConnectedError: It is followed already.
            ConnectionError: It fails; says why.
        """
        config = self.config
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{config.source} is connected")
        if config.force is not None:
            self._force = st.load_force(config.force).estimator()
        given = {"preset": config.preset, "rate_hz": config.rate_hz}
        self._live = st.live(config.source, calibration=self._calibration, **given)
        self._taken = 0
        try:
            if warmup:
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
        frame = self._latest(max_age_ms)
        return self._force.update(frame.t_us, frame.displacement_px.astype(np.float64)).values

    def disconnect(self) -> None:
        """Stop to follow the sensor.

        Raises:
            DeviceNotConnectedError: It is not followed.
        """
        self._followed().close()
        self._live = None

    def _followed(self) -> st.Live:
        if self._live is None:
            raise DeviceNotConnectedError(f"{self.config.source} is not connected")
        return self._live

    def _next(self, timeout_s: float) -> Any:
        live, source = self._followed(), self.config.source
        deadline_s = time.monotonic() + timeout_s
        while True:
            frame = live.latest()
            if frame is not None and frame.number > self._taken:
                self._taken = frame.number
                return frame
            health = live.health
            if health.state not in ("starting", "running"):
                raise ConnectionError(f"{source}: {health.state} {health.why}".strip())
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"{source} gave no new frame in {timeout_s:g} s")
            time.sleep(LOOK_S)

    def _latest(self, max_age_ms: int) -> Any:
        frame = self._followed().latest()
        if frame is None:
            raise RuntimeError(f"{self.config.source} has given no frame yet")
        age_ms = (time.monotonic_ns() - frame.told_ns) * 1e-6
        if age_ms > max_age_ms:
            raise TimeoutError(f"the latest frame of {self.config.source} is {age_ms:.0f} ms old")
        return frame

    def _image(self, frame: Any) -> NDArray[np.uint8]:
        look = self._calibration.grid or (1, len(frame.coasted)), RANGE_PX, CELL_PX
        return field_image(frame.displacement_px, frame.coasted, *look)
