"""Public names of the room ``calibration``."""

from .pitch import marker_pitch_px as marker_pitch_px
