"""Verbs on event files."""
