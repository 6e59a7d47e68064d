"""The hole experiment (paper section V-C)."""
