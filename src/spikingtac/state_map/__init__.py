"""The dynamic state map M(x, y): what the sensor sees, rebuilt from events (paper section IV-A)."""
