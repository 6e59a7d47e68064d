"""Events: sources, formats, windows and filters."""
