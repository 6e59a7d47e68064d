"""Learn rest positions and appearance of the markers from a recording."""
