"""Markers by centroids of the graded map: preset ``fast``."""
