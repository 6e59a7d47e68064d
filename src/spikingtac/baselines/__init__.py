"""Other groups' trackers behind the package's own protocol, re-derived from formulas."""
