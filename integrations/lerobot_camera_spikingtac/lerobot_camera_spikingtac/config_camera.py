"""The settings of a sensor, registered with LeRobot as the camera type ``spikingtac``."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from lerobot.cameras.configs import CameraConfig

DEFAULT_FPS = 30
RANGE_PX = 16.0  # Displacement that is drawn as 0 or 255, px.
CELL_PX = 8  # Width of a marker's cell in the image, px.


@CameraConfig.register_subclass("spikingtac")
@dataclass(kw_only=True)
class SpikingTacCameraConfig(CameraConfig):
    """A sensor as a camera.

    Attributes:
        source: A camera's address, or a recording, which is played.
        calibration: The sensor's ``calibration.json``.
        preset: Tracker: ``default``, ``fast``, or a TOML file.
        rate_hz: Estimates per second; the preset's unless given.
        force: ``force.onnx``, where forces are wanted, too.
    """

    source: str
    calibration: str
    preset: str = "fast"
    rate_hz: float | None = None
    force: str | None = None

    def __post_init__(self) -> None:
        """Fill in the size of the image, which the grid decides; markers without rows are one.

        Raises:
            ValueError: The size is not that of the grid.
        """
        known = json.loads(Path(self.calibration).read_text(encoding="utf-8"))
        rows, columns = known.get("grid") or (1, len(known["reference_px"]))
        size = columns * CELL_PX, rows * CELL_PX
        if (self.width or size[0], self.height or size[1]) != size:
            raise ValueError(
                f"the image is {size[0]}x{size[1]}: {columns} by {rows} markers of {CELL_PX} "
                "px each; leave width and height out"
            )
        self.width, self.height = size
        self.fps = self.fps or DEFAULT_FPS
