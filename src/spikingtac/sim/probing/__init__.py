"""Probing on the twin: readings of touches, and the calibration on a flat wall."""
