"""Arms and closed loops (paper sections V-B and V-C)."""
