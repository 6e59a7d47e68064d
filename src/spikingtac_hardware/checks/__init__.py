"""Whether a design can be built and works: every check with its figure, its limit and a reason."""
