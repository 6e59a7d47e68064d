"""ROS bags with event packets: sqlite3, MCAP and ROS 1."""
