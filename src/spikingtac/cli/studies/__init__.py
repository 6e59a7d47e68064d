"""Verbs that repeat experiments and train networks."""
