"""Explain all events at once: places, shapes and steps, refined until ideal pixels fire alike."""
