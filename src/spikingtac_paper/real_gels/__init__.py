"""Recordings of real gels, and of sensors like the real one with truth."""
