"""The contact path of a robot: detector, watchdog and arm in a process of their own."""
