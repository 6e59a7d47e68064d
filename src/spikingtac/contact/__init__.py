"""Perception at 1 kHz: contacts from raw event counts (paper section V-B)."""
