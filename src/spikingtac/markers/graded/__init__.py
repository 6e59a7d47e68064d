"""The presets default and fast: locate markers in the graded map."""
