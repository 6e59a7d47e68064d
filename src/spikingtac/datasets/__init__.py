"""Tracks as data sets for robot learning: LeRobot, and Zarr for those who use another tool."""
