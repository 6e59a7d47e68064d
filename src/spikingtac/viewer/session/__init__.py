"""One viewing session: open, play, track, publish."""
