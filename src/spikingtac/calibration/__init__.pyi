"""Public names of the room ``calibration``."""

from .lens import marker_pitch_px as marker_pitch_px
