"""Trials with truth, methods, predictions and metrics."""
