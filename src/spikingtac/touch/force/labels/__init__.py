"""Whether labels belong to the displacements: their clock and their axes."""
