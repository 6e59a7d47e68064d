"""A node for machines with ROS 2: follows a sensor with spikingtac, publishes its field with rclpy.

    python3 tactile_node.py --ros-args -p source:=openmv:/dev/ttyACM0 -p calibration:=left.json

NOT TESTED: there was no ROS where this was written. `spikingtac ros2` needs no ROS and is tested;
take this node where other nodes or parameters must see a node, and adapt it.

Topic field (sensor_msgs/PointCloud2, best effort): the fields of `spikingtac ros2`. Parameters:
source, calibration, preset, rate_hz, prefix. The sensor is followed in a process of its own; this
node looks for a new frame at rate_hz and publishes the latest.
"""

from __future__ import annotations

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2, PointField

import spikingtac as st

SENSOR = "sensor"
FIELDS = ("x", "y", "z", "u", "v", "du", "dv", "valid")
FLOAT_BYTES = 4
WAIT_S = 1.0


class TactileNode(Node):
    """Publishes the displacement field of one sensor."""

    def __init__(self) -> None:
        super().__init__("spikingtac")
        for name, value in (("source", ""), ("calibration", ""), ("preset", "fast")):
            self.declare_parameter(name, value)
        rate_hz = float(self.declare_parameter("rate_hz", 500.0).value)
        prefix = str(self.declare_parameter("prefix", "/tactile").value)
        given = {name: str(self.get_parameter(name).value) for name in ("source", "calibration")}
        config = st.load_config(str(self.get_parameter("preset").value))
        self._calibration = st.Calibration.load(given["calibration"])
        tracking = config.with_tracking(rate_hz=rate_hz).tracking
        self._hand = st.Hand({SENSOR: st.Finger(**given, tracking=tracking)})
        self._publisher = self.create_publisher(
            PointCloud2, f"{prefix}/field", qos_profile_sensor_data
        )
        self._shown, self._told = 0, ""
        self.create_timer(1.0 / rate_hz, self._show)
        self.create_timer(WAIT_S, self._look)

    def _show(self) -> None:
        reading = self._hand.latest()[SENSOR]
        if reading is not None and reading.number > self._shown:
            self._shown = reading.number
            self._publisher.publish(self._cloud(reading))

    def _look(self) -> None:
        health = self._hand.health()[SENSOR]
        if health.state in ("failed", "killed", "ended") and health.state != self._told:
            self._told = health.state
            self.get_logger().error(f"the sensor has {health.state}: {health.why}")

    def _cloud(self, reading: st.MarkerFrame) -> PointCloud2:
        rest_px, scale = self._calibration.reference_px, self._calibration.px_per_mm or 1.0
        about_px = rest_px - (np.array(self._calibration.size) - 1) / 2
        moved_px = reading.displacement_px
        table = np.zeros((len(rest_px), len(FIELDS)), np.float32)
        table[:, 0:2] = about_px / scale
        table[:, 3:5], table[:, 5:7], table[:, 7] = rest_px + moved_px, moved_px, ~reading.coasted
        cloud = PointCloud2(height=1, width=len(rest_px), is_dense=True)
        cloud.header.frame_id = "tactile_sensor"
        cloud.header.stamp = self.get_clock().now().to_msg()
        cloud.fields = [
            PointField(name=name, offset=FLOAT_BYTES * n, datatype=PointField.FLOAT32, count=1)
            for n, name in enumerate(FIELDS)
        ]
        cloud.point_step = FLOAT_BYTES * len(FIELDS)
        cloud.row_step = cloud.point_step * len(rest_px)
        cloud.data = table.tobytes()
        return cloud

    def destroy_node(self) -> None:
        """Stop to follow the sensor, too."""
        self._hand.close()
        super().destroy_node()


def main() -> None:
    """Publish until Ctrl-C."""
    rclpy.init()
    node = TactileNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
