"""spikingtac sensors as cameras of LeRobot."""

from lerobot_camera_spikingtac.camera import SpikingTacCamera
from lerobot_camera_spikingtac.config_camera import SpikingTacCameraConfig

__all__ = ["SpikingTacCamera", "SpikingTacCameraConfig"]
