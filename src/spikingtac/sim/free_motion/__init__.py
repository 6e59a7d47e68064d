"""Motion of a probe without contact, with sparse rendering of its events."""
