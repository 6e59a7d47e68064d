"""Calibrating a sensor with the page: the guide, the run and its result."""
