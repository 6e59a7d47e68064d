"""Verbs that move a robot."""
