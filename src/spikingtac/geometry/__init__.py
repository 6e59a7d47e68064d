"""Geometry by touch (paper section V-C)."""
