"""ROS bags: their storages, and the messages of events in them."""
