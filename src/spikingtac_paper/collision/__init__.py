"""The collision experiment (paper section V-B)."""
