"""Rests, levels and the grid of markers: what is seen before anything is followed."""
