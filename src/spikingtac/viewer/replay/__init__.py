"""A stored stream that is tracked forwards and revisited at any time."""
