"""A node for machines with ROS 2: follows a sensor with spikingtac, publishes its field with rclpy.

    python3 tactile_node.py --ros-args -p source:=openmv:/dev/ttyACM0 -p calibration:=left.json

NOT TESTED: there was no ROS where this was written. `spikingtac ros2` needs no ROS and is tested;
take this node where other nodes or parameters must see a node, and adapt it.

Topic field (sensor_msgs/PointCloud2, best effort): the fields of `spikingtac ros2`. Parameters:
source, calibration, preset, rate_hz, prefix. The sensor is followed in a process of its own.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2, PointField

import spikingtac as st

FIELDS = ("x", "y", "z", "u", "v", "du", "dv", "valid")
FLOAT_BYTES = 4
DEFAULTS = {"source": "", "calibration": "", "preset": "fast", "rate_hz": 500.0}


def cloud_of(frame: st.MarkerFrame, calibration: st.Calibration, stamp: object) -> PointCloud2:
    """Return the displacement field of a frame."""
    rest_px, moved_px = calibration.reference_px, frame.displacement_px
    about_px = rest_px - (np.array(calibration.size) - 1) / 2
    table = np.zeros((len(rest_px), len(FIELDS)), np.float32)
    table[:, 0:2] = about_px / (calibration.px_per_mm or 1.0)
    table[:, 3:5], table[:, 5:7], table[:, 7] = rest_px + moved_px, moved_px, ~frame.coasted
    cloud = PointCloud2(height=1, width=len(rest_px), is_dense=True)
    cloud.header.frame_id, cloud.header.stamp = "tactile_sensor", stamp
    cloud.fields = [
        PointField(name=name, offset=FLOAT_BYTES * n, datatype=PointField.FLOAT32, count=1)
        for n, name in enumerate(FIELDS)
    ]
    cloud.point_step = FLOAT_BYTES * len(FIELDS)
    cloud.row_step = cloud.point_step * len(rest_px)
    cloud.data = table.tobytes()
    return cloud


def main() -> None:
    """Publish every frame until Ctrl-C."""
    rclpy.init()
    node = Node("spikingtac")
    given = {name: node.declare_parameter(name, value).value for name, value in DEFAULTS.items()}
    prefix = node.declare_parameter("prefix", "/tactile").value
    publisher = node.create_publisher(PointCloud2, f"{prefix}/field", qos_profile_sensor_data)
    given["calibration"] = calibration = st.Calibration.load(given["calibration"])
    try:
        with suppress(KeyboardInterrupt), st.live(given.pop("source"), **given) as sensor:
            for frame in sensor:
                stamp = node.get_clock().now().to_msg()
                publisher.publish(cloud_of(frame, calibration, stamp))
                rclpy.spin_once(node, timeout_sec=0.0)
    except st.SpikingTacError as error:
        node.get_logger().error(str(error))
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
