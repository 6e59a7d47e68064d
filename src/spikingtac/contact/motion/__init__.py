"""The sequential test of the markers' signed evidence for a common motion."""
