"""Touches: when each begins and ends, where it is and how large."""
