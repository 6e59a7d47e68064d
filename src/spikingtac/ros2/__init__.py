"""ROS 2 messages: their definitions and bytes, and a publisher over DDS; without ROS installed."""
