"""Trackers of other groups, re-derived from their publications, with this package's protocol."""
