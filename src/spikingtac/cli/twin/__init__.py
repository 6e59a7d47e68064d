"""Verbs of the digital twin."""
