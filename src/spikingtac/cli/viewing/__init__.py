"""Verbs that show recordings and results."""
