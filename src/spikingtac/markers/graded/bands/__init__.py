"""Bands: discs fitted to the levels at which pixels fired, where OFF events are rare."""
