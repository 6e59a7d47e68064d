"""Verbs that turn events into results."""
