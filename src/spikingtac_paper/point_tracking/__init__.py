"""The point-tracking experiment (paper section V-A)."""
