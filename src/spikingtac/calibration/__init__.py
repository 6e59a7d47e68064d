"""The calibration of a sensor: its values and its file."""
